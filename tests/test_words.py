"""Pages are written for their readers: sentences, words and links."""

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
words = runpy.run_path(str(ROOT / "docs" / "check_words.py"))


@pytest.mark.parametrize("path", words["all_pages"](), ids=lambda path: path.name)
def test_a_page_has_short_sentences_plain_words_and_living_links(path):
    page = words["read_page"](path)
    assert not page.faults, "\n".join(map(str, page.faults))


def test_messages_have_plain_words():
    faults = words["faults_of_messages"]()
    assert not faults, "\n".join(map(str, faults))


def test_docstrings_and_help_have_short_sentences_and_plain_words():
    package = words["read_package"]()
    assert len(package.sentences) > 5000
    assert not package.faults, "\n".join(map(str, package.faults))


def test_prose_of_a_docstring_is_its_sentences_and_those_of_its_entries():
    doc = """Sum two numbers.

    Both are :class:`floats`, or ``inf``. A formula is no prose::

        c = a + b

    Parameters
    ----------
    a, b : float
        In metres. None is none.

    Examples
    --------
    >>> print("A line. Another.")
    A line. Another.
    """
    prose = words["prose_of_docstring"](doc)
    found = []
    for paragraph in words["paragraphs"](prose):
        found += [s.text for s in words["sentences_of"](paragraph)]
    assert found == [
        "Sum two numbers.",
        "Both are code, or code.",
        "A formula is no prose.",
        "In metres.",
        "None is none.",
    ]
    assert len(prose.splitlines()) <= len(doc.splitlines())


def page_of(tmp_path, text):
    path = tmp_path / "page.md"
    path.write_text(text, "utf-8")
    return words["read_page"](path)


def test_sentences_are_those_of_the_prose(tmp_path):
    text = """# A heading of seven words is none

Two words. Is this a question? See eqs. 4 and Fig. 3 of `code.with.dots`.

- an item

| a table | of words. Of words. |
|---|---|

```python
x = 1  # A comment. Another.
```
"""
    page = page_of(tmp_path, text)
    assert [s.n_words for s in page.sentences] == [2, 4, 8, 2]
    assert not page.faults


@pytest.mark.parametrize(
    "text",
    [
        "The data " + "always " * 40 + "matter.",
        "The sensor tells the displacement.",
        "The values were meaned over 20 seeds.",
        "See [the page](nowhere.md).",
        "![a picture](images/none.png)",
    ],
)
def test_a_page_with_a_fault_is_named_with_its_line(tmp_path, text):
    (fault, *_) = page_of(tmp_path, f"# Page\n\n{text}\n").faults
    assert fault.page == "page.md" and fault.line == 3


def test_held_out_data_are_a_word_of_the_field(tmp_path):
    assert not page_of(tmp_path, "The held-out data are held out.\n").faults
    assert page_of(tmp_path, "The mass is held.\n").faults


@pytest.mark.parametrize(
    "name",
    ["method", "noise", "what_a_test_cannot_show", "performance", "damage", "paper"],
)
def test_an_explanation_has_a_picture(name):
    assert "](images/" in (ROOT / "docs" / f"{name}.md").read_text("utf-8")
