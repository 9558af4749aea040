"""Every public function and class is documented, with an example that runs."""

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
# scikit-learn writes these into every estimator and describes them there
ROUTING = re.compile(r"set_\w+_request|get_metadata_routing")
# types of results that need a description of shape, unit or columns
VAGUE_TYPES = re.compile(r"\bAny\b|ndarray|DataFrame|Series|^$")
DESCRIPTIONS = ("Parameters", "Other Parameters", "Attributes")


def module_of(obj) -> str:
    return getattr(obj, "__module__", None) or ""


def is_ours(obj) -> bool:
    return module_of(obj).startswith("pysindy_nrf")


# -- what is public ------------------------------------------------------------


def public_of(module) -> dict[str, object]:
    """Classes and functions of ``__all__``, or those that a module itself defines."""
    names = getattr(module, "__all__", None)
    if names is None:
        names = []
        for name, value in vars(module).items():
            if not name.startswith("_") and module_of(value) == module.__name__:
                names.append(name)

    public = {}
    for name in names:
        value = getattr(module, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            public[name] = value
    return public


def all_public() -> dict[str, object]:
    """Public objects by their full name, each once."""
    modules = [pysindy_nrf]
    for name in LISTED:
        is_object = name.removeprefix("pysindy_nrf.") in pysindy_nrf._LAZY
        if name.islower() and not is_object:
            modules.append(importlib.import_module(name))

    objects = {}
    for module in modules:
        for name, obj in public_of(module).items():
            if obj not in objects.values():
                objects[f"{module.__name__}.{name}"] = obj
    return objects


def members_of(cls) -> dict[str, object]:
    """Public methods and properties that the package writes, its bases included."""
    members = {}
    for base in reversed(cls.__mro__):
        if is_ours(base):
            for name, member in vars(base).items():
                if not name.startswith("_") and not ROUTING.fullmatch(name):
                    members[name] = getattr(member, "__func__", member)
    return members


PUBLIC = all_public()
CLASSES = {name: obj for name, obj in PUBLIC.items() if inspect.isclass(obj)}
METHODS = {
    f"{name}.{method}": (cls, method)
    for name, cls in CLASSES.items()
    for method, member in members_of(cls).items()
    if inspect.isfunction(member)
}


# -- what a docstring says -----------------------------------------------------


def section(doc: str, title: str) -> str | None:
    """The text below a numpydoc heading, up to the next."""
    underline = "-" * len(title)
    match = re.search(
        rf"^{title}\n{underline}\n(.*?)(?=^\w[\w ]*\n---+\n|\Z)",
        doc,
        re.DOTALL | re.MULTILINE,
    )
    return match and match.group(1)


def described(doc: str) -> set[str]:
    """Names with an entry ``name : type`` or ``name, other : type``."""
    names = set()
    for title in DESCRIPTIONS:
        text = section(inspect.cleandoc(doc), title) or ""
        entry = r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: *:.*)?$"
        for head in re.findall(entry, text, re.MULTILINE):
            names |= {name.lstrip("*") for name in head.split(", ")}
    return names


def docs_referred_to(doc: str, cls: type | None) -> list[str]:
    """Docstrings of what a summary refers to: they need not be repeated."""
    summary = inspect.cleandoc(doc).split("\n\n")[0]
    docs = []
    for name in re.findall(r":(?:func|meth|class):`~?([\w.]+)`", summary):
        if hasattr(cls, name):
            docs.append(inspect.getdoc(getattr(cls, name)) or "")
            continue
        for known, obj in PUBLIC.items():
            if f".{known}".endswith(f".{name}"):
                docs.append(inspect.getdoc(obj) or "")
        for known, (owner, method) in METHODS.items():
            if known.endswith(f".{name}"):
                docs.append(inspect.getdoc(getattr(owner, method)) or "")
    return docs


# -- what a function does ------------------------------------------------------


def arguments_of(function) -> set[str]:
    names = [name for name in inspect.signature(function).parameters]
    if names and names[0] in ("self", "cls"):
        names = names[1:]
    return {name for name in names if not name.startswith("_")}


def syntax_of(function) -> list[ast.AST]:
    """The syntax of a function without that of functions inside it."""
    source = textwrap.indent(inspect.getsource(function), " ")
    tree = ast.parse(f"if True:\n{source}").body[0]
    (definition,) = (node for node in tree.body if isinstance(node, ast.FunctionDef))
    nodes = []
    pending = list(definition.body)
    while pending:
        node = pending.pop()
        nodes.append(node)
        if not isinstance(node, ast.FunctionDef | ast.Lambda):
            pending += ast.iter_child_nodes(node)
    return nodes


def returns_something_vague(function) -> bool:
    """Whether a result is described by neither its type nor its absence."""
    annotation = str(function.__annotations__.get("return", ""))
    if not VAGUE_TYPES.search(annotation):
        return False
    for node in syntax_of(function):
        if isinstance(node, ast.Return) and node.value is not None:
            is_none = isinstance(node.value, ast.Constant) and node.value.value is None
            if not is_none:
                return True
    return False


def raises_an_error(function) -> bool:
    """Whether a function raises, but that a method is for others to write."""
    for node in syntax_of(function):
        if isinstance(node, ast.Raise) and node.exc is not None:
            if not ast.unparse(node.exc).startswith("NotImplementedError"):
                return True
    return False


def sections_owed(function) -> list[str]:
    owed = []
    kinds = (ast.Yield, ast.YieldFrom)
    if any(isinstance(node, kinds) for node in syntax_of(function)):
        owed.append("Yields")
    elif returns_something_vague(function):
        owed.append("Returns")
    if raises_an_error(function):
        owed.append("Raises")
    return owed


def missing_from(function, cls: type | None = None) -> list[str]:
    """Parameters and sections that the docstring of a function lacks."""
    doc = inspect.getdoc(function) or ""
    docs = [doc, *docs_referred_to(doc, cls)]
    known = set().union(*map(described, docs))
    missing = [f"parameter {name}" for name in arguments_of(function) - known]
    for title in sections_owed(function):
        if not any(section(text, title) for text in docs):
            missing.append(title)
    return missing


# -- the tests -----------------------------------------------------------------


@pytest.mark.parametrize("name", PUBLIC)
def test_it_is_described_with_an_example_that_runs(name):
    doc = inspect.getdoc(PUBLIC[name]) or ""
    assert len(doc.partition("\n")[0]) > 10, "no summary"
    assert ">>> " in (section(doc, "Examples") or ""), "no example"
    assert "+SKIP" not in doc


@pytest.mark.parametrize("name", [name for name in PUBLIC if name not in CLASSES])
def test_a_function_says_what_it_takes_and_gives(name):
    assert not missing_from(PUBLIC[name])


@pytest.mark.parametrize("name", CLASSES)
def test_a_class_says_what_it_takes(name):
    cls = CLASSES[name]
    doc = inspect.getdoc(cls) or ""
    is_result = section(doc, "Attributes") and not section(doc, "Parameters")
    if is_result:  # it is never built by hand
        return
    known = set()
    for base in cls.__mro__:
        if is_ours(base):
            known |= described(base.__doc__ or "")
    assert arguments_of(cls) <= known


@pytest.mark.parametrize("name", METHODS)
def test_a_method_says_what_it_takes_and_gives(name):
    """Itself, or that of a base which it overrides."""
    cls, method = METHODS[name]
    assert inspect.getdoc(getattr(cls, method)), "no docstring"
    versions = []
    for base in cls.__mro__:
        if is_ours(base) and method in vars(base):
            member = vars(base)[method]
            versions.append(getattr(member, "__func__", member))
    missing = [missing_from(version, cls) for version in versions]
    assert [] in missing, missing[0]


@pytest.mark.parametrize("name", CLASSES)
def test_properties_say_what_they_are(name):
    for member in members_of(CLASSES[name]).values():
        if isinstance(member, property):
            assert inspect.getdoc(member)
