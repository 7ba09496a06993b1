"""What is not flown of an SVG document: remarks on omissions, and errors."""

from dataclasses import dataclass

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.svg_document import SvgElement
from crazychoir.planning.drawing.svg_shapes import SHAPE_NAMES


@dataclass(frozen=True, slots=True)
class SvgAdvice:
    """Texts for what is flown of a picture, and what to do about the rest."""

    flown: str = f"{', '.join(SHAPE_NAMES)}, alone, in groups, in nested svg and by use"
    """Text for what is allowed."""
    release: str = "Release the clip or mask (Inkscape: Object, Clip, Release), or cut the shape itself."
    """Advice for clips and masks."""
    unlink: str = "Unlink the clone, or delete it."
    """Advice for clones."""


SVG_ADVICE = SvgAdvice()


class SvgReport:
    """Collects remarks on a document, and builds errors that name its elements.

    where: name of the document in errors
    words: the remarks, in the order of the document
    """

    def __init__(self, where: str) -> None:
        self.where = where
        self.words: list[str] = []

    def note(self, remark: str) -> None:
        """Add a remark."""
        self.words.append(remark)

    def leave_out(self, element: SvgElement, reason: str) -> None:
        """Remark that an element is left out, and why."""
        self.words.append(f"{element.label}: left out: {reason}")

    def build_refusal(
        self,
        element: SvgElement,
        found: str,
        do: str = "",
        allowed: str = SVG_ADVICE.flown,
    ) -> ConfigError:
        """Return the error for an element that cannot be flown."""
        return ConfigError(self.where, f"{element.label} {found}".rstrip(), allowed, do)
