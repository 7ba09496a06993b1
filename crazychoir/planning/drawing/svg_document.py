"""SVG documents as trees of elements, read without following entities or files."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from crazychoir.errors import ConfigError

SVG_NAMESPACE = "http://www.w3.org/2000/svg"
XLINK_NAMESPACE = "http://www.w3.org/1999/xlink"
GZIP_BEGINNING = b"\x1f\x8b"


@dataclass(frozen=True, slots=True)
class SvgLimits:
    """Limits of a document that is read: a larger one is a mistake, or hostile."""

    file_size: int = 20_000_000
    """bytes."""
    elements: int = 200_000
    """Largest number of elements."""
    nesting: int = 100
    """Elements within elements."""
    entity_length: int = 200
    """characters: namespaces, as Illustrator names them."""
    quote_length: int = 80
    """Characters of a text that an error quotes."""


SVG_LIMITS = SvgLimits()


READABLE_SVG_TEXT = "a readable SVG file"
UNPACKING_ADVICE = "Unpack it: gunzip -S .svgz FILE.svgz, or save it as plain SVG."


@dataclass
class SvgElement:
    """One element of a document."""

    name: str
    """Its local name in the namespace of SVG; empty for an element of another namespace."""
    attributes: dict[str, str]
    """Its attributes by name."""
    line: int
    """Line of the document where it begins."""
    children: list["SvgElement"] = field(default_factory=list)
    """The elements directly in it."""
    text: str = ""
    """The text directly in it."""

    @property
    def label(self) -> str:
        """Its name in errors."""
        name = (
            f' id="{shorten_text(self.attributes["id"])}"'
            if self.attributes.get("id")
            else ""
        )
        return f"<{shorten_text(self.name)}{name}> in line {self.line}"

    def walk(self) -> Iterator["SvgElement"]:
        """Yield this element and all below it, in the order of the document."""
        waiting = [self]
        while waiting:
            element = waiting.pop()
            yield element
            waiting.extend(reversed(element.children))


def index_by_id(root: SvgElement) -> dict[str, SvgElement]:
    """Return the elements of a document by id; the first of several with one id."""
    found: dict[str, SvgElement] = {}
    for element in root.walk():
        if name := element.attributes.get("id"):
            found.setdefault(name, element)
    return found


def quote_text(text: str) -> str:
    """Return a text as errors quote it."""
    return repr(shorten_text(text))


def shorten_text(text: str) -> str:
    """Return a text, or the beginning of a long one."""
    return (
        text
        if len(text) <= SVG_LIMITS.quote_length
        else f"{text[: SVG_LIMITS.quote_length - 3]}..."
    )


def read_document(data: str | bytes, where: str) -> SvgElement:
    """Return the root of an SVG document.

    Nothing is loaded from elsewhere: no DTD, no external entity. An entity that the document defines
    itself may only stand for a short text without further entities.

    data: bytes in the encoding that they declare (UTF-8 if they declare none), or a decoded text
    where: name of the file in errors
    Raises ConfigError, with `where` and the line.
    """
    raw = (
        data.lstrip("\ufeff \t\r\n").encode("utf-8", "surrogatepass")
        if isinstance(data, str)
        else data
    )
    if raw.startswith(GZIP_BEGINNING) or (
        isinstance(data, str) and data.startswith("\x1f")
    ):
        raise ConfigError(
            where, "a compressed file (.svgz)", READABLE_SVG_TEXT, UNPACKING_ADVICE
        )
    if len(raw) > SVG_LIMITS.file_size:
        raise ConfigError(where, f"{len(raw)} bytes", f"at most {SVG_LIMITS.file_size}")
    builder = _Builder(where, "utf-8" if isinstance(data, str) else None)
    return builder.build(raw if isinstance(data, str) else raw.lstrip(b" \t\r\n"))


class _Builder:
    """Builds the tree of a document from the events of the parser.

    where: name of the file in errors
    encoding: of the bytes; None for the encoding that they declare
    """

    def __init__(self, where: str, encoding: str | None) -> None:
        self.where = where
        self._open: list[SvgElement] = []
        self._root: SvgElement | None = None
        self._count = 0
        parser = expat.ParserCreate(encoding, namespace_separator=" ")
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._read_text
        parser.EntityDeclHandler = self._check_entity
        parser.SkippedEntityHandler = self._refuse_entity
        parser.ProcessingInstructionHandler = self._check_instruction
        self._parser = parser

    def build(self, raw: bytes) -> SvgElement:
        """Return the root."""
        try:
            self._parser.Parse(raw, True)
        except ConfigError:
            raise
        except (expat.ExpatError, ValueError, LookupError) as error:
            found = f"a text that is no SVG, so no line of it can be flown: {error}"
            raise ConfigError(self.where, found, "well-formed XML") from error
        assert self._root is not None  # noqa: S101 - a document without a root is an ExpatError
        return self._root

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        """Add an element; raise ConfigError for too many or too deep elements."""
        self._count += 1
        if self._count > SVG_LIMITS.elements:
            raise ConfigError(
                self.where,
                f"more than {SVG_LIMITS.elements} elements",
                f"at most {SVG_LIMITS.elements}",
            )
        if len(self._open) >= SVG_LIMITS.nesting:
            found = f"elements {SVG_LIMITS.nesting + 1} deep in line {self._parser.CurrentLineNumber}"
            raise ConfigError(
                self.where,
                found,
                f"at most {SVG_LIMITS.nesting}",
                "Ungroup the drawing.",
            )
        element = SvgElement(
            _get_local_name(name, SVG_NAMESPACE),
            _get_local_attributes(attributes),
            self._parser.CurrentLineNumber,
        )
        if self._open:
            self._open[-1].children.append(element)
        else:
            self._check_root(name, element)
            self._root = element
        self._open.append(element)

    def _check_root(self, name: str, element: SvgElement) -> None:
        """Raise ConfigError unless the root is an SVG element."""
        if not element.name or element.name == "html":
            found = f"a document of <{shorten_text(name.rpartition(' ')[2])}>"
            raise ConfigError(
                self.where, found, f'an <svg xmlns="{SVG_NAMESPACE}"> document'
            )

    def _end(self, _: str) -> None:
        self._open.pop()

    def _read_text(self, text: str) -> None:
        self._open[-1].text += text

    def _check_entity(
        self,
        name: str,
        is_parameter: bool,
        value: str | None,
        _base: object,
        _system: object,
        _public: object,
        _notation: object,
    ) -> None:
        """Raise ConfigError for an entity that is not a short text."""
        if (
            is_parameter
            or value is None
            or len(value) > SVG_LIMITS.entity_length
            or any(mark in value for mark in "&%<")
        ):
            self._refuse_entity(name, is_parameter)

    def _check_instruction(self, target: str, said: str) -> None:
        """Raise ConfigError for a style sheet in another file."""
        if target == "xml-stylesheet":
            line = self._parser.CurrentLineNumber
            found = f"a style sheet in another file, <?{target} {shorten_text(said)}?> in line {line}"
            raise ConfigError(
                self.where,
                found,
                "styles in the file itself",
                "Save the drawing as plain SVG.",
            )

    def _refuse_entity(self, name: str, _: object) -> None:
        """Raise ConfigError for an entity."""
        found = f"entity {quote_text(name)} in line {self._parser.CurrentLineNumber}"
        allowed = f"entities that the document declares as texts of at most {SVG_LIMITS.entity_length} characters"
        raise ConfigError(self.where, found, allowed, "Save the drawing as plain SVG.")


def _get_local_name(name: str, namespace: str) -> str:
    """Return the local name in the namespace, or without one; empty in another."""
    space, _, local = name.rpartition(" ")
    return local if space in ("", namespace) else ""


def _get_local_attributes(attributes: dict[str, str]) -> dict[str, str]:
    """Return the attributes without a namespace, and the link."""
    own = {name: value for name, value in attributes.items() if " " not in name}
    link = attributes.get(f"{XLINK_NAMESPACE} href")
    return own if link is None else {"href": link} | own
