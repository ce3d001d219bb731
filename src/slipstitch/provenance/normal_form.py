"""The computing part of a Python module as text, independent of wording.

The text is written from the syntax tree. Left out are

- comments, layout and docstrings, those of attributes too;
- the words of errors: text that stands directly in ``raise X("...")``, also in f-strings, sums and
  ``"...".format(...)``. What such a text is filled with stays, as it is computed; so do other
  arguments, as a caught error may hand on values. No code decides by the wording of an error.
  Likewise Slipstitch's own errors where they are made, and what is printed to ``sys.stderr``;
- the words of settings and options: ``description``, ``title`` and ``examples`` of pydantic's
  ``Field``, and ``help``, ``metavar``, ``description`` and ``epilog`` of argparse; those of
  progress bars.

Other printed lines and the words of pages and tables stay: they are in results.
"""

import ast
import functools
from collections.abc import Iterator
from typing import Any

_FIELD_WORDS = frozenset({"description", "title", "examples"})
_OPTION_WORDS = frozenset({"help", "metavar", "description", "epilog"})
_BAR_WORDS = frozenset({"description", "desc", "unit"})
_WORDS_OF = {
    "Field": _FIELD_WORDS,
    "ArgumentParser": _OPTION_WORDS,
    "add_argument": _OPTION_WORDS,
    "add_argument_group": _OPTION_WORDS,
    "add_parser": _OPTION_WORDS,
    "add_subparsers": _OPTION_WORDS,
    "progress": _BAR_WORDS,
    "tqdm": _BAR_WORDS,
}
_SPOKEN = frozenset({"BadInput", "Damaged", "NotConverged", "SlipstitchError", "progress"})
# They say how a name or a string was written, not what it is.
_NO_MEANING = frozenset({"ctx", "kind", "type_comment"})
_ASSIGNS = (ast.Assign, ast.AnnAssign)
_VALIDATORS = frozenset({"field_validator", "model_validator"})


@functools.cache
def parsed(text: str, name: str) -> ast.Module:
    """The syntax tree of a module without its words; not to be changed.

    Raises
    ------
    SyntaxError
        If it is not Python; the message contains `name`.
    """
    tree = ast.parse(text, filename=name)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            body[:] = [inner for inner in body if not _is_text(inner)]
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            for argument in node.exc.args:
                _blank(argument)
        elif isinstance(node, ast.Call):
            if called(node) in _SPOKEN or _to_stderr(node):
                for argument in node.args:
                    _blank(argument)
            words = _WORDS_OF.get(called(node) or "", frozenset())
            node.keywords = [word for word in node.keywords if word.arg not in words]
    return tree


def _is_text(statement: ast.stmt) -> bool:
    """Whether the statement is a string that stands alone, such as a docstring."""
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


def _to_stderr(call: ast.Call) -> bool:
    """Whether it is ``print(..., file=sys.stderr)``."""
    return called(call) == "print" and any(
        word.arg == "file" and getattr(word.value, "attr", None) == "stderr"
        for word in call.keywords
    )


def _blank(message: ast.expr) -> None:
    """Empty the text of an error's message."""
    if isinstance(message, ast.Constant) and isinstance(message.value, str):
        message.value = ""
    elif isinstance(message, ast.JoinedStr):
        message.values = [part for part in message.values if isinstance(part, ast.FormattedValue)]
    elif isinstance(message, ast.BinOp):
        _blank(message.left)
        _blank(message.right)
    elif (
        isinstance(message, ast.Call)
        and isinstance(message.func, ast.Attribute)
        and message.func.attr == "format"
    ):
        _blank(message.func.value)


def called(call: ast.expr) -> str | None:
    """The name, without what it is an attribute of, of what is called."""
    function = call.func if isinstance(call, ast.Call) else call
    return getattr(function, "id", getattr(function, "attr", None))


def written(node: ast.AST | list | object) -> str:
    """The normal form of a syntax tree, whatever version of Python parsed it."""
    if isinstance(node, ast.AST):
        fields = (
            f"{name}={written(value)}"
            for name, value in ast.iter_fields(node)
            if name not in _NO_MEANING and value is not None and value != []
        )
        return f"{type(node).__name__}({','.join(fields)})"
    if isinstance(node, list):
        return f"[{','.join(map(written, node))}]"
    return repr(node)


@functools.cache
def normal_form(text: str, name: str) -> str:
    """The normal form of a module's source."""
    return written(parsed(text, name))


@functools.cache
def without_entries(text: str, name: str) -> str:
    """The normal form of a catalogue's source: its classes and functions, not its entries."""
    return written([node for node in parsed(text, name).body if not isinstance(node, _ASSIGNS)])


def computing_definitions(text: str, name: str) -> Iterator[tuple[str, bool, ast.AST]]:
    """The computing parts of a source of settings.

    Functions, methods, properties and constants; of a class without its methods its decorators and
    bases. Fields are left out, with defaults and bounds, and so are validators: they decide which
    values there are, and the values themselves are compared.

    Yields
    ------
    name : str
        As it is spoken of; of a class for what runs without being named, such as ``__str__``.
    is_member : bool
        Whether it is an attribute of a class.
    node : ast.AST
    """
    for node in parsed(text, name).body:
        if isinstance(node, ast.ClassDef):
            unnamed: list[Any] = [*node.bases, *node.decorator_list]
            for member in node.body:
                if not isinstance(member, ast.FunctionDef) or _validates(member):
                    continue
                if member.name.startswith("__"):
                    unnamed.append(member)
                else:
                    yield member.name, True, member
            yield node.name, False, ast.Tuple(elts=unnamed)
        elif isinstance(node, ast.FunctionDef):
            yield node.name, False, node
        elif isinstance(node, _ASSIGNS) and node.value is not None and not _bounds(node.value):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                if isinstance(target, ast.Name):
                    yield target.id, False, node


def _validates(function: ast.FunctionDef) -> bool:
    return any(called(decorator) in _VALIDATORS for decorator in function.decorator_list)


def _bounds(value: ast.expr) -> bool:
    """Whether it is a type with bounds, ``Annotated[float, Field(...)]``."""
    return isinstance(value, ast.Subscript) and called(value.value) == "Annotated"


def names_in(node: ast.AST) -> tuple[set[str], set[str]]:
    """Bare names and attributes' names that a syntax tree speaks of."""
    names, attributes = set(), set()
    for inner in ast.walk(node):
        if isinstance(inner, ast.Name):
            names.add(inner.id)
        elif isinstance(inner, ast.Attribute):
            attributes.add(inner.attr)
    return names, attributes
