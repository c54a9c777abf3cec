"""Parses IDL as rosbag2 and others store it ("ros2idl", "omgidl"): modules, structs, typedefs, enums, constants.

The text is untrusted: tokens and nesting are bounded, and only checked names and numbers leave the parser. Unions,
maps, bit sets, optional members and inheritance, which rosidl never writes, are rejected by name.

Source: OMG IDL 4.2; OMG DDS-XTypes 1.3 (sizes of enums); rosidl's generated files.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from kleinkram.recordings.decoding import types
from kleinkram.recordings.decoding.msg_definitions import split_blocks
from kleinkram.recordings.decoding.types import PRIMITIVES, Definition, FieldText, Primitive, SchemaError

_MAX_TOKENS = 400_000
_TOKEN = re.compile(
    r"\s+|//[^\n]*|\#[^\n]*"
    r'|(?P<token>L?"(?:[^"\\\n]|\\.)*"|L?\'(?:[^\'\\\n]|\\.)*\'|(?:::)?[A-Za-z_]\w*(?:::[A-Za-z_]\w*)*'
    r"|[-+]?(?:0[xX][0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?[fFdDlL]?)|::|[{}()\[\]<>;,=:@|~*/&^%+-])",
    re.DOTALL | re.ASCII,
)
_NAMES = {
    "boolean": "bool",
    "octet": "uint8",
    "char": "uint8",
    "short": "int16",
    "unsigned short": "uint16",
    "long": "int32",
    "unsigned long": "uint32",
    "long long": "int64",
    "unsigned long long": "uint64",
    "float": "float32",
    "double": "float64",
}
_REFUSED = {"union", "bitset", "bitmask", "interface", "valuetype", "exception", "native"}
_REFUSED_TYPES = {"map", "fixed", "any", "wchar"}


@dataclass
class _Scope:
    """The declarations read so far; names are whole paths such as "std_msgs/msg/Header"."""

    structs: dict[str, list[FieldText]] = field(default_factory=dict)
    typedefs: dict[str, tuple[str, str, tuple[int | None, ...]]] = field(default_factory=dict)
    enums: dict[str, Primitive] = field(default_factory=dict)
    constants: dict[str, types.ConstantValue] = field(default_factory=dict)

    def declares(self, path: str) -> bool:
        return path in self.typedefs or path in self.structs or path in self.enums


def parse_idl(name: str, text: str) -> types.Struct:
    """Return the type `name` ("std_msgs/msg/Header" or "std_msgs::msg::Header") that IDL text describes."""
    scope = _Scope()
    for _, block in split_blocks(text, "IDL:"):
        _IdlParser(block, scope).declarations("", 0)
    path = name.replace("::", "/")
    declared = next((p for p in (path, path.replace("/", "/msg/", 1)) if p in scope.structs), None)
    if declared is None:
        raise SchemaError(f"the schema's text does not define {name}")

    definitions = _Definitions(scope)
    return types.resolve(definitions.get(declared), definitions.find)


def _candidates(type_name: str, owner: str) -> list[str]:
    """Return where a name may be declared, innermost first."""
    path = type_name.replace("::", "/")
    if path.startswith("/"):
        return [path[1:]]
    modules = owner.split("/")[:-1]
    return ["/".join([*modules[:depth], path]) for depth in range(len(modules), -1, -1)]


class _Definitions:
    """The structs of a scope as definitions; each is built once, however many fields mention it."""

    def __init__(self, scope: _Scope) -> None:
        self._scope = scope
        self._built: dict[str, Definition] = {}
        self._constants: dict[str, dict[str, types.ConstantValue]] = {}
        for key, value in scope.constants.items():
            module, _, name = key.rpartition("/")
            self._constants.setdefault(module, {})[name] = value

    def find(self, type_name: str, owner: str) -> Primitive | Definition | None:
        """Return what a name means where `owner` mentions it."""
        if type_name in PRIMITIVES:
            return PRIMITIVES[type_name]
        for candidate in _candidates(type_name, owner):
            if candidate in self._scope.enums:
                return self._scope.enums[candidate]
            if candidate in self._scope.structs:
                return self.get(candidate)
        return None

    def get(self, path: str) -> Definition:
        if path not in self._built:
            fields = tuple(self._unalias(text, path) for text in self._scope.structs[path])
            self._built[path] = Definition(
                path, fields, types.constants_of(self._constants.get(f"{path}_Constants", {}))
            )
        return self._built[path]

    def _unalias(self, text: FieldText, path: str) -> FieldText:
        """Return a field of the struct `path` with what its typedefs stand for."""
        scope = self._scope
        type_name, owner, lengths = text.type_name, path, text.lengths
        for _ in range(types.MAX_DEPTH):
            # The innermost declaration of a name counts, whether it is a typedef or not.
            alias = next((c for c in _candidates(type_name, owner) if scope.declares(c)), None)
            if alias is None or alias not in scope.typedefs:
                break
            type_name, owner, inner = scope.typedefs[alias]
            lengths = inner + lengths
        else:
            raise SchemaError(f"the typedefs of {path}.{text.name} do not end")
        # What a typedef names is found from where the typedef stands.
        whole = next((c for c in _candidates(type_name, owner) if c in scope.structs or c in scope.enums), None)
        return FieldText(text.name, type_name if whole is None else f"::{whole.replace('/', '::')}", lengths)


def _tokens(text: str) -> list[str]:
    tokens: list[str] = []
    at = 0
    while at < len(text):
        if text.startswith("/*", at):
            at = text.find("*/", at + 2) + 2
            if at == 1:
                raise SchemaError("a comment does not end")
            continue
        match = _TOKEN.match(text, at)
        if match is None:
            raise SchemaError(f"'{text[at : at + 20]}' is not IDL")
        at = match.end()
        if match["token"]:
            tokens.append(match["token"])
        if len(tokens) > _MAX_TOKENS:
            raise SchemaError(f"more than {_MAX_TOKENS} words")
    return tokens


class _IdlParser:
    def __init__(self, text: str, scope: _Scope) -> None:
        self._tokens = _tokens(text)
        self._at = 0
        self._scope = scope

    def declarations(self, modules: str, depth: int) -> None:
        """Read declarations up to the end of a module or of the text."""
        if depth > types.MAX_DEPTH:
            raise SchemaError(f"modules nest more than {types.MAX_DEPTH} deep")
        while self._peek() not in ("", "}"):
            annotations = self._annotations()
            word = self._next()
            if word == "module":
                name = self._identifier()
                self._expect("{")
                self.declarations(f"{modules}{name}/", depth + 1)
                self._expect("}")
            elif word == "struct":
                self._struct(modules)
            elif word == "typedef":
                for member in self._members(modules):
                    self._scope.typedefs[modules + member.name] = (member.type_name, modules, member.lengths)
            elif word == "enum":
                self._enum(modules, annotations)
            elif word == "const":
                self._constant(modules)
            elif word in _REFUSED:
                raise SchemaError(f"IDL's {word} is not read")
            elif word != ";":
                raise SchemaError(f"'{word[:40]}' is not a declaration")
            if len(self._scope.structs) + len(self._scope.typedefs) > 2 * types.MAX_TYPES:
                raise SchemaError(f"more than {types.MAX_TYPES} types")

    def _struct(self, modules: str) -> None:
        path = modules + self._identifier()
        if self._peek() == ";":
            return
        if self._peek() == ":":
            raise SchemaError(f"{path} inherits from another type, which is not read")
        self._expect("{")
        fields: list[FieldText] = []
        while self._peek() != "}":
            if "optional" in self._annotations():
                raise SchemaError(f"{path} has optional members, which are not read")
            fields += self._members(path)
        self._expect("}")
        self._scope.structs[path] = fields

    def _members(self, owner: str) -> list[FieldText]:
        type_name, inner = self._type(owner, 0)
        fields = []
        while True:
            name = self._identifier()
            lengths: list[int | None] = []
            while self._peek() == "[":
                self._next()
                lengths.insert(0, self._length(owner))
                self._expect("]")
                if len(lengths) > types.MAX_LOOPS:
                    raise SchemaError(f"{name[:100]} is an array in more than {types.MAX_LOOPS} dimensions")
            fields.append(FieldText(name, type_name, (*inner, *lengths)))
            if self._expect(",", ";") == ";":
                return fields

    def _enum(self, modules: str, annotations: dict[str, str]) -> None:
        path = modules + self._identifier()
        bits = int(annotations.get("bit_bound", "32")) if annotations.get("bit_bound", "32").isdecimal() else 64
        if bits > 32:
            raise SchemaError(f"{path} is an enum of more than 32 bits")
        self._expect("{")
        self._skip_to("}")
        self._scope.enums[path] = PRIMITIVES["uint8" if bits <= 8 else "uint16" if bits <= 16 else "uint32"]

    def _constant(self, modules: str) -> None:
        type_name, _ = self._type(modules, 0)
        path = modules + self._identifier()
        self._expect("=")
        words = []
        while self._peek() not in (";", ""):
            words.append(self._next())
        value = _literal(type_name, words)
        if value is not None:
            self._scope.constants[path] = value

    def _type(self, owner: str, depth: int) -> tuple[str, tuple[int | None, ...]]:
        word = self._next()
        if word == "sequence":
            if depth > types.MAX_DEPTH:
                raise SchemaError(f"sequences nest more than {types.MAX_DEPTH} deep")
            self._expect("<")
            name, lengths = self._type(owner, depth + 1)
            if self._expect(",", ">") == ",":
                self._length(owner)
                self._expect(">")
            return name, (*lengths, None)
        if word in ("string", "wstring"):
            if self._peek() == "<":
                self._next()
                self._length(owner)
                self._expect(">")
            return word, ()
        while word in ("unsigned", "long", "unsigned long") and self._peek() in ("short", "long", "double"):
            word = f"{word} {self._next()}"
        if word in _REFUSED_TYPES or word in ("long double", "unsigned"):
            raise SchemaError(f"IDL's type {word} is not read")
        if not re.match(r"(::)?[A-Za-z_]", word):
            raise SchemaError(f"'{word[:40]}' is not a type")
        return _NAMES.get(word, word), ()

    def _length(self, owner: str) -> int:
        word = self._next()
        value: object = int(word) if word.isdecimal() and len(word) < 19 else None
        for candidate in _candidates(word, owner) if value is None else ():
            value = self._scope.constants.get(candidate, value)
        if not isinstance(value, int):
            raise SchemaError(f"'{word[:40]}' is not a length")
        return value

    def _annotations(self) -> dict[str, str]:
        """Skip annotations and return their names with the first word of their arguments."""
        annotations: dict[str, str] = {}
        while self._peek() == "@":
            self._next()
            name = self._next()
            annotations[name] = ""
            if self._peek() == "(":
                self._next()
                annotations[name] = self._peek()
                self._skip_to(")")
        return annotations

    def _skip_to(self, closing: str) -> None:
        """Skip everything up to the bracket that closes an open one."""
        opening, depth = {")": "(", "}": "{"}[closing], 1
        while depth:
            word = self._next()
            depth += (word == opening) - (word == closing)

    def _peek(self) -> str:
        return self._tokens[self._at] if self._at < len(self._tokens) else ""

    def _next(self) -> str:
        word = self._peek()
        if not word:
            raise SchemaError("the text ends in the middle of a declaration")
        self._at += 1
        return word

    def _expect(self, *words: str) -> str:
        word = self._next()
        if word not in words:
            raise SchemaError(f"'{word[:40]}' is not one of {' '.join(words)}")
        return word

    def _identifier(self) -> str:
        """Return a simple name; a leading "_" only marks it as no keyword of IDL."""
        word = self._next()
        if not re.fullmatch(r"[A-Za-z_]\w*", word, re.ASCII):
            raise SchemaError(f"'{word[:40]}' is not a name")
        return word.removeprefix("_")


def _literal(type_name: str, words: list[str]) -> types.ConstantValue | None:
    """Return the value of a constant; None for one that is computed."""
    text = "".join(words)
    if type_name in ("string", "wstring"):
        return "".join(word.removeprefix("L")[1:-1] for word in words)
    if type_name == "bool":
        return text.upper() == "TRUE"
    if len(words) > 2 or len(text) > 80:
        return None
    try:
        return float(text.rstrip("fFdDlL")) if type_name.startswith("float") else int(text, 0)
    except ValueError:
        return None
