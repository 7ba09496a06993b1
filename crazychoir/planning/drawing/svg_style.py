"""Styles of SVG elements: attributes, `style` and style sheets decide what is seen."""

import re
from dataclasses import dataclass
from typing import NoReturn

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.svg_document import (
    SvgElement,
    quote_text,
    shorten_text,
)

INITIAL_VALUES = ("initial", "unset", "revert", "revert-layer")
"""Values that reset a property."""


@dataclass(frozen=True, slots=True)
class StyleProperties:
    """Names of the properties that decide what is seen."""

    followed: tuple[str, ...] = (
        "display",
        "visibility",
        "opacity",
        "overflow",
        "fill",
        "fill-opacity",
        "stroke",
        "stroke-opacity",
        "stroke-width",
        "stroke-linecap",
        "clip-path",
        "mask",
        "marker",
        "marker-start",
        "marker-mid",
        "marker-end",
        "transform-origin",
    )
    """Properties that decide what is seen and where; each may be an attribute, too."""
    inherited: tuple[str, ...] = (
        "visibility",
        "fill",
        "stroke",
        "fill-opacity",
        "stroke-opacity",
        "stroke-width",
        "stroke-linecap",
    )
    """Properties that an element gets from the element around it."""
    markers: tuple[str, ...] = ("marker", "marker-start", "marker-mid", "marker-end")
    """Properties for markers."""


STYLE_PROPERTIES = StyleProperties()


ANY_ELEMENT = ""
"""Stands for elements of any name."""
BOX_ELEMENTS = ("rect", "svg", "symbol", "use", "image", "foreignObject")
"""Elements with a place and a size."""
GEOMETRY_PROPERTIES = {
    **dict.fromkeys(
        ("transform", "translate", "rotate", "scale", "offset-path"), (ANY_ELEMENT,)
    ),
    **dict.fromkeys(("x", "y", "width", "height"), BOX_ELEMENTS),
    **dict.fromkeys(("cx", "cy"), ("circle", "ellipse")),
    **dict.fromkeys(("rx", "ry"), ("rect", "ellipse")),
    "r": ("circle",),
    "d": ("path",),
}
"""Properties of CSS that would move or reshape these elements.

They are refused, because attributes can say the same.
"""


@dataclass(frozen=True, slots=True)
class _StylePatterns:
    """Patterns of style sheets and values."""

    no_paint: re.Pattern[str] = re.compile(
        r"none|transparent|#[0-9a-f]{3}0|#[0-9a-f]{6}00", re.IGNORECASE
    )
    """a value that paints nothing."""
    alpha: re.Pattern[str] = re.compile(
        r"(?:rgb|hsl)a\([^()]*,([^(),]*)\)|(?:rgb|hsl)a?\([^()]*/([^()/]*)\)",
        re.IGNORECASE,
    )
    """The opacity of a colour."""
    comment: re.Pattern[str] = re.compile(r"/\*.*?(?:\*/|\Z)|<!--|-->", re.DOTALL)
    """a comment."""
    harmless_rule: re.Pattern[str] = re.compile(
        r"@(?:charset|namespace)[^;]*(?:;|\Z)|@font-face\s*\{[^{}]*(?:\}|\Z)"
    )
    """An at-rule that changes nothing that is seen."""
    simple_selector: re.Pattern[str] = re.compile(
        r"(\*|[A-Za-z][\w-]*)?((?:[.#][\w-]+)*)\Z", re.ASCII
    )
    """An element, classes and an id."""
    pointed_at: re.Pattern[str] = re.compile(
        r":(hover|focus|active|visited|focus-within|focus-visible)\b"
    )
    """a selector that needs a pointer."""


_STYLE_PATTERNS = _StylePatterns()


@dataclass(frozen=True)
class StyleRule:
    """One selector of a style sheet with its declarations."""

    name: str
    """Name of the elements; empty for all."""
    classes: frozenset[str]
    """Classes that an element must have."""
    id: str | None
    """Id that an element must have; None for any."""
    declarations: dict[str, tuple[str, bool]]
    """{property: (value, whether it is marked !important)}."""

    def applies_to(self, element: SvgElement) -> bool:
        """Return whether the selector selects an element."""
        return (
            self.name in ("", element.name)
            and (self.id is None or self.id == element.attributes.get("id"))
            and self.classes <= set(element.attributes.get("class", "").split())
        )

    @property
    def specificity(self) -> tuple[int, int, int]:
        """Numbers of ids, classes and element names, which CSS compares in this order."""
        return int(self.id is not None), len(self.classes), int(self.name != "")


class StyleSheets:
    """The style sheets, attributes and `style` of the elements of a document.

    Sheets may select by element, class and id. Another selector, or another rule than `{}`, is
    refused if it sets a property that decides what is seen.

    root: of the document
    where: name of the document in errors
    Raises ConfigError with `where` and the element.
    """

    def __init__(self, root: SvgElement, where: str) -> None:
        self.where = where
        self._root = root
        self._rules: list[StyleRule] = []
        for element in root.walk():
            if element.name == "style" and _is_followed(element):
                self._rules += self._read_sheet(element)
        self._rules.sort(key=lambda rule: rule.specificity)

    def of(self, element: SvgElement) -> dict[str, str]:
        """Return the values of the followed properties of an element, by name.

        Words are in small letters.
        """
        found = {
            name: element.attributes[name]
            for name in STYLE_PROPERTIES.followed
            if name in element.attributes
        }
        sheets = [rule.declarations for rule in self._rules if rule.applies_to(element)]
        own = _parse_declarations(element.attributes.get("style", ""))
        for important in (False, True):
            for declarations in (*sheets, own):
                chosen = {
                    name: value
                    for name, (value, is_strong) in declarations.items()
                    if is_strong is important
                }
                found |= chosen
        found = {name: value.strip() for name, value in found.items()}
        self._check_geometry(element, found)
        return {
            name: value if "(" in value else value.lower()
            for name, value in found.items()
        }

    def _check_geometry(self, element: SvgElement, found: dict[str, str]) -> None:
        """Raise ConfigError for a style that moves or reshapes the element.

        The size of the page changes nothing.
        """
        for name, elements in GEOMETRY_PROPERTIES.items():
            value = found.get(name, "none").strip()
            is_meant = ANY_ELEMENT in elements or (
                element.name in elements and element is not self._root
            )
            if is_meant and value not in ("none", "auto", *INITIAL_VALUES):
                what = f"{element.label} with a style {name}: {shorten_text(value)}"
                do = f"Write it as an attribute of the element: {name}=..., or save the drawing as plain SVG."
                raise ConfigError(
                    self.where, what, "styles that neither move nor reshape", do
                )

    def _read_sheet(self, element: SvgElement) -> list[StyleRule]:
        """Return the rules of a style sheet."""
        sheet = _STYLE_PATTERNS.harmless_rule.sub(
            " ", _STYLE_PATTERNS.comment.sub(" ", element.text)
        )
        if mark := re.search(r"@[\w-]+", sheet):
            self._refuse(element, shorten_text(mark.group()))
        rules: list[StyleRule] = []
        for rule in sheet.split("}"):
            selectors, opened, body = rule.partition("{")
            if "{" in body:
                self._refuse(element, f"a rule within {quote_text(selectors.strip())}")
            declarations = _parse_declarations(body) if opened else {}
            for selector in selectors.split(","):
                rules += self._read_rule(element, selector.strip(), declarations)
        return rules

    def _read_rule(
        self,
        element: SvgElement,
        selector: str,
        declarations: dict[str, tuple[str, bool]],
    ) -> list[StyleRule]:
        """Return the rule, or none if it never applies or does not matter."""
        matters = any(
            name in declarations
            for name in (*STYLE_PROPERTIES.followed, *GEOMETRY_PROPERTIES)
        )
        if not matters or _STYLE_PATTERNS.pointed_at.search(selector):
            return []
        found = _STYLE_PATTERNS.simple_selector.match(selector)
        if found is None or not selector:
            self._refuse(element, quote_text(selector))
        parts = re.findall(r"[.#][\w-]+", found[2])
        ids = {part[1:] for part in parts if part[0] == "#"}
        if len(ids) > 1:
            return []
        classes = frozenset(part[1:] for part in parts if part[0] == ".")
        return [
            StyleRule(
                "" if found[1] in (None, "*") else found[1],
                classes,
                min(ids, default=None),
                declarations,
            )
        ]

    def _refuse(self, element: SvgElement, what: str) -> NoReturn:
        """Raise ConfigError for a style sheet that cannot be read."""
        do = "Write what it sets as attributes of the elements, or save the drawing as plain SVG."
        raise ConfigError(
            self.where,
            f"{element.label} with {what}",
            "selectors of an element, .class or #id",
            do,
        )


def _is_followed(sheet: SvgElement) -> bool:
    """Return whether a <style> element is CSS for a screen."""
    media = sheet.attributes.get("media", "all").strip().lower()
    return sheet.attributes.get("type", "text/css").strip() in (
        "",
        "text/css",
    ) and media in ("", "all", "screen")


def _parse_declarations(body: str) -> dict[str, tuple[str, bool]]:
    """Return the values of `name: value; ...` by name, and whether they are important."""
    found: dict[str, tuple[str, bool]] = {}
    for part in _STYLE_PATTERNS.comment.sub(" ", body).split(";"):
        name, colon, value = part.partition(":")
        name = name.strip().lower()
        if not colon or name not in (*STYLE_PROPERTIES.followed, *GEOMETRY_PROPERTIES):
            continue
        value, mark, _ = value.partition("!")
        is_important = bool(mark)
        if is_important or not found.get(name, ("", False))[1]:
            found[name] = (value.strip(), is_important)
    return found


def select_inherited(outer: dict[str, str], style: dict[str, str]) -> dict[str, str]:
    """Return the inherited properties of an element.

    outer: properties of the element around it
    style: of the element
    """
    found = dict(outer)
    for name in STYLE_PROPERTIES.inherited:
        value = style.get(name, "inherit")
        if value == "initial":
            found.pop(name, None)
        elif value not in ("inherit", *INITIAL_VALUES):
            found[name] = value
    return found


def find_hiding_property(style: dict[str, str]) -> str:
    """Return the property that hides an element and all in it; empty if none does."""
    if style.get("display") == "none":
        return "display: none"
    return "" if _parse_share(style.get("opacity", "1")) > 0.0 else "opacity: 0"


def is_visible(inherited: dict[str, str]) -> bool:
    """Return whether `visibility` shows an element."""
    return inherited.get("visibility", "visible") not in ("hidden", "collapse")


def has_dots(inherited: dict[str, str]) -> bool:
    """Return whether a line without length is seen, as a dot of the width of the stroke."""
    return _is_paint(inherited.get("stroke", "none")) and inherited.get(
        "stroke-linecap"
    ) in ("round", "square")


def is_painted(name: str, inherited: dict[str, str]) -> bool:
    """Return whether a shape has a fill or a stroke.

    A line has no fill, but counts as drawn if nothing is said about its stroke.
    """
    has_stroke = (
        _is_paint(inherited.get("stroke", "none"))
        and _parse_share(inherited.get("stroke-opacity", "1")) > 0.0
        and _parse_share(inherited.get("stroke-width", "1")) > 0.0
    )
    if name == "line" and "stroke" in inherited:
        return has_stroke
    has_fill = (
        _is_paint(inherited.get("fill", "black"))
        and _parse_share(inherited.get("fill-opacity", "1")) > 0.0
    )
    return has_stroke or has_fill


def _parse_share(text: str) -> float:
    """Return the number at the beginning of a value, such as 50% or 2px.

    Returns 1 without one, as for a value in error.
    """
    found = re.match(r"[-+]?[0-9]*\.?[0-9]+(?:e[-+]?[0-9]+)?", text.strip().lower())
    return float(found.group()) if found else 1.0


def _is_paint(value: str) -> bool:
    """Return whether a value is a visible colour or pattern."""
    if _STYLE_PATTERNS.no_paint.fullmatch(value):
        return False
    alpha = _STYLE_PATTERNS.alpha.fullmatch(value)
    return alpha is None or _parse_share(alpha[1] or alpha[2]) > 0.0
