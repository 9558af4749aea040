"""Every public function and class is documented: what goes in, what comes out, and an
example that runs.
"""

import ast
import importlib
import inspect
import re
import textwrap
from pathlib import Path

import pytest

import pysindy_nrf

API = Path(__file__).parents[1] / "docs" / "api.rst"
LISTED = re.findall(r"^   (pysindy_nrf\.[\w.]+)$", API.read_text("utf-8"), re.MULTILINE)
MODULES = [
    m
    for m in LISTED
    if m.islower() and m.removeprefix("pysindy_nrf.") not in pysindy_nrf._LAZY
]
# scikit-learn writes these into every estimator and describes them there
ROUTING = re.compile(r"set_\w+_request|get_metadata_routing")


def home(obj) -> str:
    return getattr(obj, "__module__", None) or ""


def public_of(module) -> dict[str, object]:
    """What a module offers: its ``__all__``, or else what it defines under names
    without an underscore.
    """
    names = getattr(module, "__all__", None)
    if names is None:
        names = [
            n
            for n, v in vars(module).items()
            if not n.startswith("_") and home(v) == module.__name__
        ]
    found = {n: getattr(module, n) for n in names}
    return {
        n: v for n, v in found.items() if inspect.isclass(v) or inspect.isfunction(v)
    }


def solve_order() -> dict[str, object]:
    modules = [pysindy_nrf, *map(importlib.import_module, MODULES)]
    found = {}
    for module in modules:
        for name, obj in public_of(module).items():
            if obj not in found.values():
                found[f"{module.__name__}.{name}"] = obj
    return found


PUBLIC = solve_order()
CLASSES = {name: obj for name, obj in PUBLIC.items() if inspect.isclass(obj)}


def methods_of(cls) -> dict[str, object]:
    """Public methods and properties that the package itself writes, the bases of the
    package included.
    """
    found: dict[str, object] = {}
    for base in reversed(cls.__mro__):
        if home(base).startswith("pysindy_nrf"):
            found.update(
                {
                    n: v
                    for n, v in vars(base).items()
                    if not n.startswith("_") and not ROUTING.fullmatch(n)
                }
            )
    unwrapped = {
        n: v.__func__ if isinstance(v, classmethod | staticmethod) else v
        for n, v in found.items()
    }
    return {
        n: v
        for n, v in unwrapped.items()
        if inspect.isfunction(v) or isinstance(v, property)
    }


METHODS = {
    f"{name}.{method}": (cls, method, member)
    for name, cls in CLASSES.items()
    for method, member in methods_of(cls).items()
    if inspect.isfunction(member)
}


def section(doc: str, title: str) -> str | None:
    """The text below a numpydoc heading, up to the next."""
    match = re.search(
        rf"^{title}\n-{{{len(title)}}}\n(.*?)(?=^\w[\w ]*\n---+\n|\Z)",
        doc,
        re.DOTALL | re.MULTILINE,
    )
    return match and match.group(1)


def described(doc: str) -> set[str]:
    """Parameters with an entry: ``name : type`` or ``name, other : type`` at the margin
    of a section.
    """
    doc = inspect.cleandoc(doc)
    text = "\n".join(
        filter(
            None,
            (section(doc, t) for t in ("Parameters", "Other Parameters", "Attributes")),
        )
    )
    heads = re.findall(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: *:.*)?$", text, re.MULTILINE)
    return {name.lstrip("*") for head in heads for name in head.split(", ")}


def taken(function) -> set[str]:
    names = inspect.signature(function).parameters
    return {
        n
        for i, n in enumerate(names)
        if not n.startswith("_") and not (i == 0 and n in ("self", "cls"))
    }


def own_body(function) -> list[ast.AST]:
    """The syntax of a function without that of functions inside it."""
    source = inspect.getsource(function)
    tree = ast.parse("if True:\n" + textwrap.indent(source, " "))
    tree = next(n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef))
    inner = [
        n
        for n in ast.walk(tree)
        if isinstance(n, ast.FunctionDef | ast.Lambda) and n is not tree
    ]
    hidden = {id(n) for f in inner for n in ast.walk(f)}
    return [n for n in ast.walk(tree) if id(n) not in hidden]


def gives(function) -> str | None:
    """The section that a function owes: Returns, Yields or none; a method that returns
    itself owes it too.
    """
    own = own_body(function)
    if any(isinstance(n, ast.Yield | ast.YieldFrom) for n in own):
        return "Yields"
    if not re.search(
        r"\bAny\b|ndarray|DataFrame|Series|^$",
        str(function.__annotations__.get("return", "")),
    ):
        return None  # the annotation says it: there is no shape, unit or column to add
    values = [n.value for n in own if isinstance(n, ast.Return) and n.value is not None]
    return (
        "Returns"
        if any(not (isinstance(v, ast.Constant) and v.value is None) for v in values)
        else None
    )


def refuses(function) -> bool:
    """Whether a function raises an error of its own; that a method is for others to
    write is none.
    """
    thrown = [
        n.exc
        for n in own_body(function)
        if isinstance(n, ast.Raise) and n.exc is not None
    ]
    return any(
        not ast.unparse(error).startswith("NotImplementedError") for error in thrown
    )


def owners(doc: str, cls: type | None = None) -> list[str]:
    """Docstrings of the functions and methods that a summary refers to: what they say
    need not be said again.
    """
    summary = inspect.cleandoc(doc).split("\n\n")[0]
    known = {**PUBLIC, **{name: member for name, (_, _, member) in METHODS.items()}}
    found = []
    for name in re.findall(r":(?:func|meth|class):`~?([\w.]+)`", summary):
        own = (
            [getattr(cls, name)]
            if hasattr(cls, name)
            else [o for n, o in known.items() if f".{n}".endswith(f".{name}")]
        )
        found += [inspect.getdoc(o) or "" for o in own]
    return found


def lacks(function, doc: str, cls: type | None = None) -> list[str]:
    docs = [doc, *owners(doc, cls)]
    missing = [
        f"parameter {n}"
        for n in sorted(taken(function) - set().union(*map(described, docs)))
    ]
    owed = [s for s in (gives(function), "Raises" if refuses(function) else None) if s]
    return missing + [s for s in owed if not any(section(d, s) for d in docs)]


@pytest.mark.parametrize("name", PUBLIC)
def test_it_is_described_with_an_example_that_runs(name):
    obj = PUBLIC[name]
    doc = inspect.getdoc(obj) or ""
    assert len(doc.splitlines()[0] if doc else "") > 10, "no summary"
    assert "+SKIP" not in doc
    examples = section(doc, "Examples")
    assert examples is not None and ">>> " in examples, "no example that runs"
    if inspect.isfunction(obj):
        assert not lacks(obj, doc)
    elif section(doc, "Parameters") or not section(
        doc, "Attributes"
    ):  # else it is a result, never built by hand
        said = {
            n
            for base in obj.__mro__
            if home(base).startswith("pysindy_nrf")
            for n in described(base.__doc__ or "")
        }
        assert not taken(obj) - said


@pytest.mark.parametrize("name", METHODS)
def test_a_method_says_what_it_takes_and_gives(name):
    cls, method, function = METHODS[name]
    assert inspect.getdoc(getattr(cls, method)), "no docstring"
    # what overrides a method of the package need not say again what the contract says
    # once
    contract = [
        vars(base)[method]
        for base in cls.__mro__
        if home(base).startswith("pysindy_nrf") and method in vars(base)
    ]
    contract = [getattr(f, "__func__", f) for f in contract]
    assert any(not lacks(f, inspect.getdoc(f) or "", cls) for f in contract), lacks(
        function, function.__doc__ or "", cls
    )


@pytest.mark.parametrize("name", CLASSES)
def test_properties_say_what_they_are(name):
    bare = [
        n
        for n, v in methods_of(CLASSES[name]).items()
        if isinstance(v, property) and not inspect.getdoc(v)
    ]
    assert not bare
