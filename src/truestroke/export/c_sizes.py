"""Sizes of the kernel's structs on a chip, from its header alone: before anything is compiled."""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

OPERATORS: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.floordiv,
}
MEMBER = re.compile(
    r"\s*(?:(?P<kind>struct|union)\s*\{|(?:const\s+)?(?:unsigned\s+)?(?P<type>\w+)\s+(?P<names>[^;]+);)"
)
MACRO = re.compile(r"(?m)^#define (\w+)(?:\((\w+)\))? (\S.*?)\s*$")
ENUM = re.compile(r"typedef enum \{([^}]*)\} (\w+);")


@dataclass(frozen=True)
class _Layout:
    """Size and alignment, bytes."""

    size: int
    alignment: int


def struct_sizes(header: str, precision: str, pointer: int = 4) -> dict[str, int]:
    r"""Bytes of each struct of the kernel's header.

    Parameters
    ----------
    header : str
        Text of truestroke.h with the capacities of the chip.
    precision : {"double", "single"}
        Number type.
    pointer : int
        Bytes of a pointer.

    Returns
    -------
    dict
        Sizes by the names of the structs, where each number is at a multiple of its size.

    Examples
    --------
    >>> struct_sizes("#define N 3\ntypedef struct { bool a; ts_real b[N][2]; } pair;", "single")
    {'pair': 28}
    """
    text = re.sub(r"/\*.*?\*/", " ", header, flags=re.DOTALL)
    real = 8 if precision == "double" else 4
    plain = {"ts_real": real, "bool": 1, "char": 1, "int": 4, "uint64_t": 8, "*": pointer}
    constants = {name: (argument, ast.parse(body, mode="eval").body)
                 for name, argument, body in MACRO.findall(text) if re.fullmatch(r"[\w\s()+*/-]+", body)
                 and not re.search(r"\)\s*\w|double|float", body)}  # fmt: skip
    for names, enum in ENUM.findall(text):
        plain[enum] = 4
        for place, name in enumerate(part.split()[0] for part in names.split(",") if part.strip()):
            constants[name] = ("", ast.Constant(place))
    reader = _Reader({name: _Layout(size, size) for name, size in plain.items()}, constants)
    for match in re.finditer(r"typedef struct \{", text):
        layout, rest = reader.members(text[match.end() :], "struct")
        reader.layouts[rest.partition(";")[0].strip()] = layout
    return {name: layout.size for name, layout in reader.layouts.items() if name not in plain}


@dataclass
class _Reader:
    """What is known of the header so far: layouts of types, and constants with the name of their argument."""

    layouts: dict[str, _Layout]
    constants: Mapping[str, tuple[str, ast.expr]]

    def members(self, text: str, kind: str) -> tuple[_Layout, str]:
        """The layout of a struct or union whose members begin here, and the text behind its brace."""
        size, widest = 0, 1
        while (member := MEMBER.match(text)) is not None:
            text = text[member.end() :]
            if member["kind"]:
                inner, text = self.members(text, member["kind"])
                names, _, text = text.partition(";")
            else:
                inner, names = self.layouts[member["type"]], member["names"]
            for name in re.split(r",(?![^\[]*\])", names):
                one = self.layouts["*"] if "*" in name.partition("[")[0] else inner
                begin = 0 if kind == "union" else _rounded(size, one.alignment)
                size, widest = max(size, begin + one.size * self._entries(name)), max(widest, one.alignment)
        return _Layout(_rounded(size, widest), widest), text[text.index("}") + 1 :]

    def _entries(self, name: str) -> int:
        count = 1
        for length in re.findall(r"\[([^\]]*)\]", name):
            count *= self.value(ast.parse(length.strip(), mode="eval").body, {})
        return count

    def value(self, node: ast.expr, known: Mapping[str, int]) -> int:
        """Of an expression of constants; `known` are the arguments of a macro."""
        match node:
            case ast.Constant(value=int(number)):
                return number
            case ast.BinOp(left, action, right):
                return OPERATORS[type(action)](self.value(left, known), self.value(right, known))
            case ast.Name(name) if name in known:
                return known[name]
            case ast.Name(name):
                return self.value(self.constants[name][1], {})
            case ast.Call(ast.Name(name), [given]):
                argument, body = self.constants[name]
                return self.value(body, {argument: self.value(given, known)})
        raise ValueError(f"the kernel's header has the length {ast.unparse(node)}")


def _rounded(size: int, alignment: int) -> int:
    return -(-size // alignment) * alignment
