"""Names of SVG elements, and the surroundings in which an element is drawn."""

from dataclasses import dataclass, replace

from crazychoir.planning.drawing.svg_clip import ClipOutline
from crazychoir.planning.drawing.svg_shapes import ViewportSize
from crazychoir.types import Mat


@dataclass(frozen=True, slots=True)
class ElementNames:
    """Names of elements, by what becomes of them."""

    containers: tuple[str, ...] = ("g", "a", "svg", "switch", "use")
    """Elements that hold others."""
    definitions: tuple[str, ...] = (
        "defs",
        "symbol",
        "clipPath",
        "marker",
        "pattern",
        "mask",
        "linearGradient",
        "radialGradient",
        "filter",
        "style",
        "script",
        "title",
        "desc",
        "metadata",
        "view",
        "cursor",
        "font",
        "font-face",
        "color-profile",
        "hatch",
        "solidcolor",
        "meshgradient",
    )
    """Elements that are not drawn where they stand."""
    animations: tuple[str, ...] = (
        "animate",
        "animateMotion",
        "animateTransform",
        "animateColor",
        "set",
        "discard",
        "mpath",
    )
    """Elements that change others with time."""
    texts: tuple[str, ...] = ("text", "textPath", "tspan", "tref", "altGlyph")
    """Elements of text."""
    pictures: tuple[str, ...] = (
        "image",
        "foreignObject",
        "video",
        "audio",
        "iframe",
        "canvas",
    )
    """Elements of other content."""


ELEMENT_NAMES = ElementNames()


@dataclass(frozen=True)
class ElementScene:
    """The surroundings of an element."""

    matrix: Mat
    """(3, 3), from its units to those of the picture."""
    inherited: dict[str, str]
    """Properties by name."""
    viewport: ViewportSize | None
    """The size that lengths in % refer to; None if unknown."""
    clips: tuple[ClipOutline, ...] = ()
    """Clips outside which the element is not seen."""
    users: tuple[str, ...] = ()
    """Links of the <use> elements that show it."""
    depth: int = 0
    """Number of elements around it."""

    def transformed(self, matrix: Mat) -> "ElementScene":
        """Return the scene with a further transform."""
        return replace(self, matrix=self.matrix @ matrix)

    def placed(self, places: Mat) -> Mat:
        """Return places (k, 2) in units of the picture."""
        moved: Mat = places @ self.matrix[:2, :2].T + self.matrix[:2, 2]
        return moved
