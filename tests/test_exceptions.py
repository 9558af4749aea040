"""Errors and warnings: all typed, all of one shape, all documented; nothing else is
raised on purpose.
"""

import ast
import inspect
import pickle

import pytest
from sources import trees

from pysindy_nrf import exceptions
from pysindy_nrf.exceptions import MissingExtraError, NRFError, NRFWarning

CLASSES = [
    c
    for name, c in vars(exceptions).items()
    if inspect.isclass(c)
    and c.__module__ == exceptions.__name__
    and not name.startswith("_")
]
ERRORS = [c for c in CLASSES if issubclass(c, NRFError)]
WARNINGS = [c for c in CLASSES if issubclass(c, NRFWarning)]

# What is raised besides, with the reason. (file, class)
ALLOWED = {
    ("common/lazy.py", "AttributeError"): "the protocol of module attributes",
    ("laws/contract.py", "AssertionError"): "a check that a law failed, as documented",
    (
        "common/compiled.py",
        "TypingError",
    ): "the protocol of numba, which tries other types",
    ("records/channels.py", "kind"): "one of two typed errors, chosen above",
    ("common/__init__.py", "error"): "a typed error that the caller chose",
    (
        "sindy/compared_models.py",
        "OverflowError",
    ): "caught by the time limit's own loop",
    ("sindy/compared_models.py", "TimeoutError"): "caught by the time limit's own loop",
    (
        "equations/chain_solve.py",
        "NotTogether",
    ): "an NRFError, caught by the selection, which solves one by one",
    ("equations/least_squares.py", "NotTogether"): "the same",
    ("selection/order_sums.py", "NotTogether"): "the same",
}
# Readers' helpers: the reader turns their ValueError into a FileFormatError
# (test_fuzz.py holds it to that).
HELPERS = {
    "records/files/attributes.py",
    "records/files/formats/matlab.py",
    "records/files/formats/numpy_files.py",
    "records/files/formats/uff.py",
    "common/files.py",
    "cli/parameters.py",
}
# The sentences of a solve order say themselves what would help.
CURE_INSIDE = {"chain/identifiability.py": "its reasons say what would help"}
# Functions that build the error they are named for.
BUILDERS = {
    node.name
    for _, tree in trees()
    for node in ast.walk(tree)
    if isinstance(node, ast.FunctionDef)
    and isinstance(node.returns, ast.Name)
    and node.returns.id in {c.__name__ for c in CLASSES}
} | {"cannot_compile"}


def called(node: ast.expr) -> str:
    target = node.func if isinstance(node, ast.Call) else node
    return (
        target.attr if isinstance(target, ast.Attribute) else getattr(target, "id", "")
    )


def raises():
    for where, tree in trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.Raise) and node.exc is not None:
                yield where, node


@pytest.mark.parametrize("cls", CLASSES)
def test_every_class_is_documented_and_of_the_family(cls):
    assert cls.__doc__ and len(cls.__doc__.split()) >= 5 and "__doc__" in vars(cls)
    assert issubclass(cls, (NRFError, MissingExtraError, NRFWarning))
    assert issubclass(
        cls, ImportError if cls is MissingExtraError else (ValueError, UserWarning)
    )


@pytest.mark.parametrize("cls", [*ERRORS, *WARNINGS])
def test_the_message_is_what_and_cure(cls):
    error = cls("Channel a2 of record 'run 4' is dead", "Leave it out.")
    assert str(error) == "Channel a2 of record 'run 4' is dead. Leave it out."
    assert (error.what, error.cure) == (
        "Channel a2 of record 'run 4' is dead",
        "Leave it out.",
    )
    again = pickle.loads(pickle.dumps(error))  # as joblib's workers send it
    assert type(again) is cls and str(again) == str(error) and again.cure == error.cure
    assert str(cls("It is dead.")) == "It is dead."


def test_only_typed_errors_are_raised():
    typed = {c.__name__ for c in CLASSES} | BUILDERS
    wrong = []
    for where, node in raises():
        name = called(node.exc)
        usage = where.startswith("cli/") and name in (
            "UsageError",
            "BadParameter",
        )
        again = (
            not isinstance(node.exc, ast.Call) and name.islower()
        )  # an error that was caught and is passed on
        abstract = name == "NotImplementedError"  # what a subclass has to write
        helper = name == "ValueError" and where in HELPERS
        if not (
            name in typed
            or usage
            or again
            or abstract
            or helper
            or (where, name) in ALLOWED
        ):
            wrong.append(f"{where}:{node.lineno} raises {name}")
    assert not wrong, "\n".join(wrong)


def test_every_error_names_a_cure():
    names = {c.__name__ for c in ERRORS}
    without = []
    for where, node in raises():
        if isinstance(node.exc, ast.Call) and called(node.exc) in names:
            given = node.exc.args + [k.value for k in node.exc.keywords]
            starred = any(isinstance(a, ast.Starred) for a in given)
            if not starred and (
                len(given) < 2
                or any(isinstance(a, ast.Constant) and not a.value for a in given)
            ):
                if where not in CURE_INSIDE:
                    without.append(f"{where}:{node.lineno}")
    assert not without, f"raised without a cure: {', '.join(without)}"


def test_only_typed_warnings_are_given():
    names = {c.__name__ for c in WARNINGS}
    wrong = []
    for where, tree in trees():
        if where == "common/warn.py":  # passes on what it was given
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and called(node) == "warn":
                given = {
                    called(a) for a in [*node.args, *(k.value for k in node.keywords)]
                }
                if (
                    not given & names and "kind" not in given
                ):  # of that type it was when an optimizer gave it
                    wrong.append(f"{where}:{node.lineno}")
    assert not wrong, f"warned without a type of ours: {', '.join(wrong)}"
