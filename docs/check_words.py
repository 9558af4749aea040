"""Checks the words of the pages: lengths of sentences, unwanted words, links.

    python docs/check_words.py              # every page; exit code 1 if one fails
    python docs/check_words.py FILE...      # some pages
    python docs/check_words.py --package    # and docstrings, help, messages

The text of a page is its prose: without code, tables, formulas and directives. A list
item is a paragraph of its own. A sentence ends with a full stop, a question mark or an
exclamation mark before a blank and a capital letter, and with its paragraph. The text
of a docstring is its prose and that of its entries, without names, types and examples.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

# Plain-language guides ask for 15 to 20 words on average (GOV.UK: at most 25 in one
# sentence). Sentences about equations need a little more.
MOST_ON_AVERAGE = 25
MOST_IN_A_SENTENCE = 40

# Unwanted words, and what to write instead.
DIALECT = {
    r"tells?|telling|told": "shows, determines, says; 'cannot be distinguished'",
    r"held(?![- ]out)": "kept, fixed, constant",
    r"meaned": "averaged",
    r"chancy": "by chance",
    r"what is none": "a clause with a subject",
    r"astray|aloud|mended": "diverge, with a warning, corrected",
}
DIARY = {
    r"seeds?": "random_state, the number of runs",
    r"(since|up to|before|until) versions?": "nothing: the CHANGELOG has versions",
    r"earlier versions?|formerly|no longer|reruns?": "what is so today",
    r"nowadays|at the moment|so far|(this|our) machine": "what is so today",
    r"agents?|tonight|briefs?": "nothing",
}
# Words of old or vague use.
VAGUE = {
    r"of (its|their) own": "'separate', 'its'",
    r"beside": "with, next to, in addition to",
    r"(?<!as a )whole(?! (number|sample)s?)": "entire, complete, all of",
    r"but for": "except",
    r"anew": "again",
    r"as of": "'as returned by'",
    r"rivals?(?! explanations?)|rivalled": "other explanations",
}
UNWANTED_ON_PAGES = DIALECT | DIARY | VAGUE
# In the docstrings of public names and in the help of commands.
UNWANTED_IN_DOCSTRINGS = DIALECT | VAGUE

# Sections of numpydoc whose lines without an indent are names and types.
ENTRIES = (
    "Attributes",
    "Other Parameters",
    "Parameters",
    "Raises",
    "Returns",
    "See Also",
    "Warns",
    "Yields",
)
HEADING = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
DOCTEST = re.compile(r"^ *>>> .*?(?=^\s*$|\Z)", re.DOTALL | re.MULTILINE)
ROLE = re.compile(r":[\w:]+:`[^`]*`")
# Blocks of help that the command line prints as they are.
PREFORMATTED = re.compile(r"^ *\x08\n(.+\n?)*", re.MULTILINE)
DIRECTIVE = re.compile(r"^\.\. \w+::.*(\n( .*)?$)*", re.MULTILINE)

CODE_BLOCK = re.compile(r"^( *)(```|~~~).*?^\1\2[^\n]*$", re.DOTALL | re.MULTILINE)
HTML_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
FORMULA_BLOCK = re.compile(r"\$\$.*?\$\$", re.DOTALL)
IMAGE = re.compile(r"!\[[^\]]*\]\([^)]*\)")
LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]+)\)")
INLINE_CODE = re.compile(r"`+[^`]+`+")
INLINE_FORMULA = re.compile(r"\$[^$\n]+\$")
FRONT_MATTER = re.compile(r"\A---\n.*?\n---\n", re.DOTALL)
LIST_ITEM = re.compile(r"^\s*([-*]|\d+\.)\s+")
BLOCK_AFTER_COLONS = re.compile(r"::\n\n( .*\n|\n)+")
SENTENCE_END = re.compile(r"(?<=[.?!])[\"')*]*\s+(?=[\"'(*_]*[A-Z0-9])")
ABBREVIATION_END = re.compile(r"(?:\b(?:eqs?|Figs?|e\.g|i\.e|vs|approx)|\.)\.$")
WORD = re.compile(r"[A-Za-z0-9][\w'’.,/%+-]*")


@dataclass(frozen=True)
class Fault:
    """Something on a page that is to be changed."""

    page: str
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.text}"


@dataclass(frozen=True)
class Sentence:
    """A sentence, and the line where its paragraph begins."""

    line: int
    text: str

    @property
    def n_words(self) -> int:
        return len(WORD.findall(self.text))


@dataclass(frozen=True)
class Page:
    """A page, its sentences and its faults."""

    name: str
    sentences: tuple[Sentence, ...]
    faults: tuple[Fault, ...]

    @property
    def n_words(self) -> int:
        return sum(sentence.n_words for sentence in self.sentences)

    @property
    def average(self) -> float:
        return self.n_words / max(len(self.sentences), 1)

    @property
    def longest(self) -> int:
        return max((sentence.n_words for sentence in self.sentences), default=0)

    @property
    def n_unwanted(self) -> int:
        return sum("write instead" in fault.text for fault in self.faults)


# -- from a page to its sentences ----------------------------------------------


def blank(match: re.Match) -> str:
    """The line breaks of a match, so that line numbers stay."""
    return "\n" * match.group().count("\n")


def prose_of(text: str) -> str:
    """The page without code, formulas, pictures, comments and addresses."""
    text = FRONT_MATTER.sub(blank, text)
    for pattern in (CODE_BLOCK, HTML_COMMENT, FORMULA_BLOCK, IMAGE):
        text = pattern.sub(blank, text)
    text = INLINE_CODE.sub("code", text)
    text = INLINE_FORMULA.sub("x", text)
    return LINK.sub(r"\1", text)


def paragraphs(prose: str) -> Iterator[Sentence]:
    """Paragraphs and list items; no headings, tables and indented code."""
    lines: list[str] = []
    start = 1
    for number, line in enumerate([*prose.splitlines(), ""], 1):
        is_apart = not line.strip() or line.startswith(("#", "|", "    "))
        is_item = bool(LIST_ITEM.match(line))
        if lines and (is_apart or is_item):
            yield Sentence(start, " ".join(lines))
            lines = []
        if not is_apart:
            if not lines:
                start = number
            lines.append(LIST_ITEM.sub("", line).strip())


def sentences_of(paragraph: Sentence) -> Iterator[Sentence]:
    """The sentences of a paragraph; abbreviations do not end one."""
    pending = ""
    for piece in SENTENCE_END.split(paragraph.text):
        pending = f"{pending} {piece}".strip()
        if not ABBREVIATION_END.search(pending):
            yield Sentence(paragraph.line, pending)
            pending = ""
    if pending:
        yield Sentence(paragraph.line, pending)


# -- what is wrong with them ---------------------------------------------------


def unwanted_words(name: str, text: str, unwanted: dict[str, str]) -> list[Fault]:
    """Unwanted words of a text, by line."""
    faults = []
    for number, line in enumerate(text.splitlines(), 1):
        for pattern, better in unwanted.items():
            match = re.search(rf"\b({pattern})\b", line, re.IGNORECASE)
            if match is None:
                continue
            faults.append(
                Fault(name, number, f"'{match.group()}': write instead: {better}")
            )
    return faults


def long_sentences(name: str, sentences: tuple[Sentence, ...]) -> list[Fault]:
    faults = []
    for sentence in sentences:
        if sentence.n_words > MOST_IN_A_SENTENCE:
            start = " ".join(sentence.text.split()[:6])
            text = f"a sentence of {sentence.n_words} words: '{start} ...'"
            faults.append(Fault(name, sentence.line, text))
    return faults


def dead_links(path: Path, text: str) -> list[Fault]:
    """Links and pictures of a page whose file is not there.

    Files that the build of the pages makes are not looked for.
    """
    faults = []
    without_code = CODE_BLOCK.sub(blank, text)
    for match in LINK.finditer(without_code):
        target = match[2]
        file = target.split("#")[0]
        is_elsewhere = re.match(r"\w+:", target) or "generated/" in target
        if file and not is_elsewhere and not (path.parent / file).exists():
            line = 1 + without_code.count("\n", 0, match.start())
            faults.append(Fault(path.name, line, f"dead link: {target}"))
    return faults


def read_page(path: Path) -> Page:
    """Read and check a page."""
    text = path.read_text("utf-8")
    prose = prose_of(text)
    sentences = tuple(
        sentence
        for paragraph in paragraphs(prose)
        for sentence in sentences_of(paragraph)
    )
    tables = CODE_BLOCK.sub(blank, text)
    faults = [
        *long_sentences(path.name, sentences),
        *unwanted_words(path.name, INLINE_CODE.sub("", tables), UNWANTED_ON_PAGES),
        *dead_links(path, text),
    ]
    page = Page(path.name, sentences, tuple(faults))
    if page.average > MOST_ON_AVERAGE:
        text = f"{page.average:.1f} words a sentence on average"
        faults.append(Fault(path.name, 1, text))
    return Page(path.name, sentences, tuple(faults))


# -- the package ---------------------------------------------------------------


def strings_of(path: Path) -> Iterator[Sentence]:
    """Docstrings and messages of a module with their lines."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if " " in node.value.strip():
                yield Sentence(node.lineno, INLINE_CODE.sub("", node.value))


def prose_of_docstring(doc: str) -> str:
    """The prose of a docstring, with its number of lines.

    Headings, names and types of entries, examples and formulas are left out.
    """
    text = inspect.cleandoc(doc)
    for pattern in (DOCTEST, DIRECTIVE, PREFORMATTED):
        text = pattern.sub(blank, text)
    text = BLOCK_AFTER_COLONS.sub(lambda match: "." + blank(match), text)
    for pattern in (ROLE, INLINE_CODE):
        text = pattern.sub(lambda match: "code" + blank(match), text)
    pieces = HEADING.split(text)
    prose = [pieces[0]]
    for heading, body in zip(pieces[1::2], pieces[2::2]):
        prose.append("\n")
        for line in body.splitlines(keepends=True):
            is_entry = heading in ENTRIES and not line.startswith(" ")
            prose.append("\n" if is_entry else line.lstrip(" "))
    return "".join(prose)


def public_docstrings(tree: ast.Module) -> Iterator[Sentence]:
    """Docstrings of a module, of its public classes, functions and methods."""
    pending: list[ast.AST] = [tree]
    while pending:
        node = pending.pop()
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            continue
        if getattr(node, "name", "").startswith("_"):
            continue
        doc = ast.get_docstring(node, clean=False)
        if doc:
            yield Sentence(node.body[0].lineno, doc)
        if not isinstance(node, ast.FunctionDef):
            pending += node.body


def help_texts(tree: ast.Module) -> Iterator[Sentence]:
    """Texts that the command line prints of its options."""
    for node in ast.walk(tree):
        if isinstance(node, ast.keyword) and node.arg in ("help", "short_help"):
            if isinstance(node.value, ast.Constant):
                yield Sentence(node.value.lineno, str(node.value.value))


def read_module(path: Path) -> Page:
    """Read and check the docstrings of a module, and its help texts."""
    name = str(path.relative_to(ROOT))
    tree = ast.parse(path.read_text("utf-8"))
    sentences: list[Sentence] = []
    faults: list[Fault] = []
    for text in [*public_docstrings(tree), *help_texts(tree)]:
        prose = prose_of_docstring(text.text)
        for paragraph in paragraphs(prose):
            sentences += sentences_of(Sentence(text.line, paragraph.text))
        for fault in unwanted_words(name, prose, UNWANTED_IN_DOCSTRINGS):
            faults.append(Fault(name, text.line + fault.line - 1, fault.text))
    faults += long_sentences(name, tuple(sentences))
    page = Page(name, tuple(sentences), tuple(faults))
    if page.average > MOST_ON_AVERAGE:
        faults.append(Fault(name, 1, f"{page.average:.1f} words a sentence on average"))
    return Page(name, tuple(sentences), tuple(faults))


def read_package() -> Page:
    """All docstrings and help texts of the package as one page."""
    sentences: list[Sentence] = []
    faults: list[Fault] = []
    for path in sorted((ROOT / "pysindy_nrf").rglob("*.py")):
        module = read_module(path)
        sentences += module.sentences
        faults += module.faults
    return Page("docstrings and help", tuple(sentences), tuple(faults))


def faults_of_messages() -> list[Fault]:
    """Unwanted words in docstrings and messages; examples in docstrings are code."""
    faults = []
    for path in sorted((ROOT / "pysindy_nrf").rglob("*.py")):
        name = str(path.relative_to(ROOT))
        for string in strings_of(path):
            prose = re.sub(r"^\s*(>>>|\.\.\.).*$", "", string.text, flags=re.MULTILINE)
            for fault in unwanted_words(name, prose, DIALECT):
                faults.append(Fault(name, string.line + fault.line - 1, fault.text))
    return faults


# -- the table -----------------------------------------------------------------


def all_pages(root: Path = ROOT) -> list[Path]:
    """Pages that users read."""
    names = ("README.md", "CHANGELOG.md", "ROADMAP.md", "CODE_OF_CONDUCT.md")
    of_the_project = [root / name for name in names] + [root / "paper" / "paper.md"]
    pages = sorted((root / "docs").glob("*.md"))
    return [path for path in [*of_the_project, *pages] if path.exists()]


def table(pages: list[Page]) -> str:
    """Words, sentences, lengths and unwanted words of each page."""
    rows = [
        f"{'page':<26}{'words':>7}{'sentences':>11}{'mean':>7}{'most':>6}{'unwanted':>10}"
    ]
    for page in pages:
        row = f"{page.name:<26}{page.n_words:>7}{len(page.sentences):>11}"
        rows.append(f"{row}{page.average:>7.1f}{page.longest:>6}{page.n_unwanted:>10}")
    return "\n".join(rows)


def main() -> int:
    """Print a table of the pages, then the faults."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument(
        "--package", action="store_true", help="docstrings and messages"
    )
    options = parser.parse_args()

    pages = [read_page(path) for path in options.files or all_pages()]
    faults = [fault for page in pages for fault in page.faults]
    if options.package:
        package = read_package()
        pages.append(package)
        faults += [*package.faults, *faults_of_messages()]

    print(table(pages))
    for fault in faults:
        print(fault)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
