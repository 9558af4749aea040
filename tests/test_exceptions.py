"""Errors and warnings are typed, of one shape, documented, and the only ones raised."""

import ast
import inspect
import pickle
from collections.abc import Iterator
from typing import NamedTuple

import pytest
from sources import trees

from pysindy_nrf import exceptions
from pysindy_nrf.exceptions import MissingExtraError, NRFError, NRFWarning


def public_classes():
    for name, value in vars(exceptions).items():
        is_ours = getattr(value, "__module__", "") == exceptions.__name__
        if inspect.isclass(value) and is_ours and not name.startswith("_"):
            yield value


CLASSES = list(public_classes())
ERRORS = [cls for cls in CLASSES if issubclass(cls, NRFError)]
WARNINGS = [cls for cls in CLASSES if issubclass(cls, NRFWarning)]

# What is raised besides, with the reason: (file, name).
ALLOWED = {
    ("common/lazy.py", "AttributeError"): "the protocol of module attributes",
    ("laws/contract.py", "AssertionError"): "a check that a law failed, as documented",
    ("common/compiled.py", "TypingError"): "the protocol of numba",
    ("records/channels.py", "kind"): "one of two typed errors, chosen above",
    ("common/__init__.py", "error"): "a typed error that the caller chose",
    ("sindy/compared_models.py", "OverflowError"): "caught by the time limit's loop",
    ("sindy/compared_models.py", "TimeoutError"): "caught by the time limit's loop",
    ("equations/chain_solve.py", "NotTogether"): "an NRFError that is caught",
    ("equations/least_squares.py", "NotTogether"): "an NRFError that is caught",
    ("selection/order_sums.py", "NotTogether"): "an NRFError that is caught",
}
# The reader of a file turns their ValueError into a FileFormatError, to which
# test_fuzz.py keeps it.
HELPERS_OF_READERS = {
    "records/files/attributes.py",
    "records/files/formats/matlab.py",
    "records/files/formats/numpy_files.py",
    "records/files/formats/uff.py",
    "common/files.py",
    "cli/parameters.py",
}
# The sentences of a solve order say themselves what would help.
CURE_INSIDE = {"chain/identifiability.py"}
USAGE_ERRORS = {"UsageError", "BadParameter"}


# -- what the code raises ------------------------------------------------------


class Raised(NamedTuple):
    """A raise statement of the package."""

    file: str
    line: int
    error: ast.expr

    @property
    def name(self) -> str:
        return name_of(self.error)

    @property
    def is_call(self) -> bool:
        return isinstance(self.error, ast.Call)

    def __str__(self) -> str:
        return f"{self.file}:{self.line} raises {self.name}"


def name_of(expression: ast.expr) -> str:
    """Last name of a name, an attribute or a call."""
    if isinstance(expression, ast.Call):
        return name_of(expression.func)
    if isinstance(expression, ast.Attribute):
        return expression.attr
    return getattr(expression, "id", "")


def arguments_of(call: ast.Call) -> list[ast.expr]:
    """Arguments of a call, by position and by name."""
    return call.args + [keyword.value for keyword in call.keywords]


def names_of(classes: list[type]) -> set[str]:
    return {cls.__name__ for cls in classes}


def nodes_of(kind: type[ast.AST]) -> Iterator[tuple[str, ast.AST]]:
    """All syntax of a kind in the package, with the file where it stands."""
    for file, tree in trees():
        for node in ast.walk(tree):
            if isinstance(node, kind):
                yield file, node


def raised() -> Iterator[Raised]:
    for file, node in nodes_of(ast.Raise):
        if node.exc is not None:
            yield Raised(file, node.lineno, node.exc)


def names_of_errors() -> set[str]:
    """Our classes, and functions that return one of them."""
    classes = names_of(CLASSES)
    functions = set()
    for _, node in nodes_of(ast.FunctionDef):
        if node.returns is not None and ast.unparse(node.returns) in classes:
            functions.add(node.name)
    return classes | functions


def is_allowed(item: Raised, typed: set[str]) -> bool:
    if item.name in typed or item.name == "NotImplementedError":
        return True
    if not item.is_call and item.name.islower():  # caught before, and passed on
        return True
    if item.name in USAGE_ERRORS:
        return item.file.startswith("cli/")
    if item.name == "ValueError":
        return item.file in HELPERS_OF_READERS
    return (item.file, item.name) in ALLOWED


def test_only_typed_errors_are_raised():
    typed = names_of_errors()
    wrong = [str(item) for item in raised() if not is_allowed(item, typed)]
    assert not wrong, "\n".join(wrong)


def lacks_a_cure(error: ast.Call) -> bool:
    arguments = arguments_of(error)
    for argument in arguments:
        if isinstance(argument, ast.Starred):
            return False
        if isinstance(argument, ast.Constant) and not argument.value:
            return True
    return len(arguments) < 2


def test_every_error_names_a_cure():
    names = names_of(ERRORS)
    without = []
    for item in raised():
        if item.is_call and item.name in names and item.file not in CURE_INSIDE:
            if lacks_a_cure(item.error):
                without.append(str(item))
    assert not without, "\n".join(without)


def warnings_given() -> Iterator[tuple[str, ast.Call]]:
    """Calls of ``warn_user`` and where they are."""
    for file, node in nodes_of(ast.Call):
        if name_of(node) == "warn_user" and file != "common/warn.py":
            yield f"{file}:{node.lineno}", node


def test_only_typed_warnings_are_given():
    # of the type "kind" a warning was when an optimizer gave it
    typed = names_of(WARNINGS) | {"kind"}
    wrong = []
    for place, call in warnings_given():
        if typed.isdisjoint(map(name_of, arguments_of(call))):
            wrong.append(place)
    assert not wrong, "\n".join(wrong)


# -- the classes ---------------------------------------------------------------


@pytest.mark.parametrize("cls", CLASSES)
def test_every_class_is_documented_and_of_the_family(cls):
    assert len(vars(cls)["__doc__"].split()) >= 5
    assert issubclass(cls, (NRFError, MissingExtraError, NRFWarning))


@pytest.mark.parametrize("cls", ERRORS)
def test_an_error_is_a_value_error(cls):
    assert issubclass(cls, ValueError)


@pytest.mark.parametrize("cls", ERRORS + WARNINGS)
def test_a_message_is_what_and_cure(cls):
    error = cls("Channel a2 is dead", "Leave it out.")
    assert str(error) == "Channel a2 is dead. Leave it out."
    assert error.what == "Channel a2 is dead"
    assert error.cure == "Leave it out."
    assert str(cls("It is dead.")) == "It is dead."


@pytest.mark.parametrize("cls", ERRORS + WARNINGS)
def test_an_error_survives_the_way_between_processes(cls):
    error = cls("Channel a2 is dead", "Leave it out.")
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is cls
    assert str(copy) == str(error)
    assert copy.cure == error.cure
