"""The visible parts of an SVG document, drawn with transforms, styles, viewports and clips."""

import math
from dataclasses import dataclass, replace

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.planning.drawing.svg_clip import ClipOutline, find_convex_corners
from crazychoir.planning.drawing.svg_document import (
    SVG_LIMITS,
    SvgElement,
    quote_text,
    shorten_text,
)
from crazychoir.planning.drawing.svg_path import (
    PATH_GRAMMAR,
    PathDataError,
    PathSizeError,
    Places,
    parse_path_data,
)
from crazychoir.planning.drawing.svg_shapes import (
    LENGTH_UNITS,
    SHAPE_NAMES,
    UNITS_PER_MILLIMETRE,
    ShapeError,
    SvgPage,
    ViewportSize,
    build_path_data,
    compute_view,
    parse_length,
    parse_transforms,
    read_page,
)
from crazychoir.planning.drawing.svg_style import (
    INITIAL_VALUES,
    STYLE_PROPERTIES,
    StyleSheets,
    find_hiding_property,
    has_dots,
    is_painted,
    is_visible,
    select_inherited,
)
from crazychoir.types import Mat

CURVE_TOLERANCE = 0.002
"""Distance in m between a curve and the straight lines that are flown."""
MOST_POINTS = 100_000
"""Largest number of places of a picture."""
MOST_DRAWN_ELEMENTS = 50_000
"""Largest number of elements that are drawn; each counts as often as it is used."""
SCALE_TOLERANCE = 0.01
"""Share by which the page's millimetres may differ from the flown ones without a remark."""


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


class SvgReader:
    """Collects the visible strokes of a document, and remarks on the rest.

    root: of the document
    where: name of the document in errors
    scale: m a unit
    """

    def __init__(self, root: SvgElement, where: str, scale: float) -> None:
        self.strokes: list[Mat] = []
        """The visible strokes, (k, 2) rows in units of the picture."""
        self.words: list[str] = []
        """Remarks on the rest."""
        self.where = where
        self._root = root
        self._scale = scale
        self._styles = StyleSheets(root, where)
        self._by_id: dict[str, SvgElement] = {}
        for element in root.walk():
            if name := element.attributes.get("id"):
                self._by_id.setdefault(name, element)
        self._page: SvgPage | None = None
        self._visits = 0
        self._points = 0

    def read(self) -> None:
        """Draw the whole document.

        Raises ConfigError for what cannot be flown, and ArithmeticError for numbers that are too
        large.
        """
        try:
            self._page = read_page(self._root)
            self._note_millimetres()
        except ShapeError as error:
            raise self._refusal(
                self._root, f"with {error.found}", allowed=error.allowed
            ) from error
        self._draw(
            self._root,
            ElementScene(np.eye(3), {}, self._page.size if self._page else None),
        )

    def _note_millimetres(self) -> None:
        """Remark that a unit of the page in millimetres differs from the unit that is flown."""
        width = self._root.attributes.get("width", "").strip().lower()
        physical = tuple(unit for unit in LENGTH_UNITS if unit not in ("", "px"))
        if (
            self._page is None
            or not self._page.size[0] > 0.0
            or not width.endswith(physical)
        ):
            return
        unit = (
            parse_length(self._root, "width", None)
            / UNITS_PER_MILLIMETRE
            / self._page.size[0]
        )
        flown = 1000.0 * self._scale
        if abs(unit / flown - 1.0) > SCALE_TOLERANCE:
            self.words.append(
                f"on the page a unit is {unit:.4g} mm; flown it is {flown:.4g} mm"
            )

    def _draw(self, element: SvgElement, scene: ElementScene) -> None:
        """Draw an element if it is drawn at all."""
        self._visits += 1
        if self._visits > MOST_DRAWN_ELEMENTS:
            raise self._refusal(
                element,
                f"as one of more than {MOST_DRAWN_ELEMENTS} elements",
                "Use fewer copies.",
            )
        if scene.depth > SVG_LIMITS.nesting:
            raise self._refusal(
                element,
                f"within more than {SVG_LIMITS.nesting} others",
                "Ungroup the drawing.",
            )
        if not element.name or element.name in ELEMENT_NAMES.definitions:
            return
        if element.name in ELEMENT_NAMES.animations:
            self._leave_out(element, "changes with time are not flown")
        elif element.name not in (
            *SHAPE_NAMES,
            *ELEMENT_NAMES.containers,
            *ELEMENT_NAMES.texts,
            *ELEMENT_NAMES.pictures,
        ):
            self._leave_out(element, "no element that is drawn")
        else:
            self._draw_styled(element, scene, {})

    def _draw_styled(
        self, element: SvgElement, scene: ElementScene, given: dict[str, str]
    ) -> None:
        """Draw an element in its style and with its transform.

        element: the element
        scene: around it
        given: width and height of the <use> that shows it
        """
        style = self._styles.of(element)
        if reason := find_hiding_property(style):
            self._leave_out(element, reason)
            return
        scene = replace(
            scene,
            inherited=select_inherited(scene.inherited, style),
            depth=scene.depth + 1,
        )
        if element.name in ELEMENT_NAMES.texts + ELEMENT_NAMES.pictures:
            self._refuse_if_seen(element, scene)
            return
        self._check_origin(element, style)
        try:
            if transform := element.attributes.get("transform"):
                scene = scene.transformed(parse_transforms(transform))
            if np.linalg.det(scene.matrix[:2, :2]) == 0.0:
                self._leave_out(element, "its transform leaves it no size")
                return
            scene = replace(
                scene, clips=scene.clips + self._clips_of(element, style, scene)
            )
            if element.name in SHAPE_NAMES:
                self._draw_shape(element, style, scene)
            elif element.name == "use":
                self._draw_use(element, scene)
            elif element.name == "symbol" or (
                element.name == "svg" and element is not self._root
            ):
                self._draw_view(element, style, scene, given)
            else:
                self._draw_children(element, scene)
        except ShapeError as error:
            raise self._refusal(
                element, f"with {error.found}", allowed=error.allowed
            ) from error

    def _check_origin(self, element: SvgElement, style: dict[str, str]) -> None:
        """Raise ConfigError for a transform about another origin."""
        origin = style.get("transform-origin", "0 0")
        is_moved = any(
            part not in ("0", "0px", "0%", "left", "top", *INITIAL_VALUES)
            for part in origin.split()
        )
        if is_moved and element.attributes.get("transform", "").strip():
            do = "Write the transform without it, or save the drawing as plain SVG."
            raise self._refusal(
                element, f"with transform-origin: {shorten_text(origin)}", do
            )

    def _draw_children(self, element: SvgElement, scene: ElementScene) -> None:
        """Draw what is in an element; of a <switch> only the first child that it may show."""
        for child in element.children:
            if element.name == "switch" and not _is_chosen(child):
                continue
            self._draw(child, scene)
            if element.name == "switch":
                return

    def _refuse_if_seen(self, element: SvgElement, scene: ElementScene) -> None:
        """Raise ConfigError for a visible text or image."""
        is_text = element.name in ELEMENT_NAMES.texts
        is_empty = is_text and not any(part.text.strip() for part in element.walk())
        if is_empty or not is_visible(scene.inherited):
            self._leave_out(element, "nothing of it is seen")
            return
        do = (
            "Turn it into a path (Inkscape: Path, Object to Path)"
            if is_text
            else "Trace it as a path"
        )
        raise self._refusal(element, "", f"{do}, hide it, or delete it.")

    def _draw_view(
        self,
        element: SvgElement,
        style: dict[str, str],
        scene: ElementScene,
        given: dict[str, str],
    ) -> None:
        """Draw what is in a nested <svg> or a used <symbol>."""
        view = compute_view(element, scene.viewport, given)
        if view is None:
            self._leave_out(element, "it has no size")
            return
        clips = scene.clips
        if view.window is not None and style.get("overflow", "hidden") not in (
            "visible",
            "auto",
        ):
            clips = (
                *clips,
                ClipOutline(
                    scene.placed(view.window), f"the window of {element.label}"
                ),
            )
        self._draw_children(
            element,
            replace(scene.transformed(view.matrix), viewport=view.size, clips=clips),
        )

    def _draw_use(self, element: SvgElement, scene: ElementScene) -> None:
        """Draw the element that a <use> refers to."""
        link = element.attributes.get("href", "").strip()
        if link and not link.startswith("#"):
            raise self._refusal(
                element,
                f"of {quote_text(link)}, which is another file",
                SVG_ADVICE.unlink,
            )
        target = self._by_id.get(link[1:])
        if target is None:
            self._leave_out(
                element, f"nothing in the file has the id {quote_text(link[1:])}"
            )
            return
        if link in scene.users:
            raise self._refusal(
                element, f"of {quote_text(link)}, which uses itself", SVG_ADVICE.unlink
            )
        wide, high = scene.viewport or (None, None)
        move = np.eye(3)
        move[:2, 2] = (
            parse_length(element, "x", wide),
            parse_length(element, "y", high),
        )
        scene = replace(scene.transformed(move), users=(*scene.users, link))
        if target.name not in ("symbol", "svg"):
            self._draw(target, scene)
            return
        given = {
            name: element.attributes.get(name, "auto") for name in ("width", "height")
        }
        given = {name: size for name, size in given.items() if size.strip() != "auto"}
        self._draw_styled(target, scene, given)

    def _draw_shape(
        self, element: SvgElement, style: dict[str, str], scene: ElementScene
    ) -> None:
        """Draw a shape if it is visible."""
        if not is_visible(scene.inherited):
            self._leave_out(element, f"visibility: {scene.inherited['visibility']}")
            return
        if not is_painted(element.name, scene.inherited):
            self._leave_out(element, "neither fill nor stroke")
            return
        strokes = [
            stroke
            for stroke in self._outline(element, scene)
            if has_dots(scene.inherited) or np.ptp(stroke, axis=0).any()
        ]
        if not strokes:
            self._leave_out(element, "it has no size")
            return
        self._points += sum(map(len, strokes))
        if self._points > MOST_POINTS:
            raise self._too_large(element)
        if any(style.get(name, "none") != "none" for name in STYLE_PROPERTIES.markers):
            self.words.append(f"{element.label}: flown without its markers")
        self._note_page(element, strokes)
        for stroke in strokes:
            if self._is_inside(element, stroke, scene.clips):
                self.strokes.append(stroke)

    def _outline(self, element: SvgElement, scene: ElementScene) -> list[Mat]:
        """Return the strokes of a shape in units of the picture."""
        tolerance = CURVE_TOLERANCE / (self._scale * _compute_widening(scene.matrix))
        try:
            found = parse_path_data(
                build_path_data(element, scene.viewport), tolerance, MOST_POINTS
            )
        except PathSizeError as error:
            raise self._too_large(element) from error
        except PathDataError as error:
            raise self._refusal(
                element, f"with {error}", allowed=PATH_GRAMMAR.allowed
            ) from error
        return [self._placed(element, stroke, scene) for stroke in found]

    def _placed(self, element: SvgElement, stroke: Places, scene: ElementScene) -> Mat:
        """Return a stroke in units of the picture; raise ConfigError if it is not finite."""
        places = np.array(stroke)
        if np.isfinite(places).all():
            places = scene.placed(places)
        if not np.isfinite(places).all():
            raise self._refusal(element, "with places that are not finite")
        return places

    def _is_inside(
        self, element: SvgElement, stroke: Mat, clips: tuple[ClipOutline, ...]
    ) -> bool:
        """Return whether a stroke is seen; raise ConfigError if a part of it may be seen."""
        for clip in clips:
            passed = clip.sides_passed(stroke)
            if passed.all():
                continue
            if not passed.any(axis=1).all():
                self._leave_out(element, f"it is outside of {clip.owner}")
                return False
            raise self._refusal(
                element, f"{clip.owner} cuts off a part of it", SVG_ADVICE.release
            )
        return True

    def _clips_of(
        self, element: SvgElement, style: dict[str, str], scene: ElementScene
    ) -> tuple[ClipOutline, ...]:
        """Return the clips of the element itself.

        Raises ConfigError for masks, and for clips that are not convex.
        """
        if self._referred(style.get("mask", "none")) is not None:
            raise self._refusal(
                element, f"with mask: {shorten_text(style['mask'])}", SVG_ADVICE.release
            )
        clip = self._referred(style.get("clip-path", "none"))
        if clip is None:
            return ()
        if not isinstance(clip, SvgElement) or clip.name != "clipPath":
            raise self._refusal(
                element,
                f"with clip-path: {shorten_text(style['clip-path'])}",
                SVG_ADVICE.release,
            )
        shapes = [
            child
            for child in clip.children
            if child.name in (*SHAPE_NAMES, *ELEMENT_NAMES.texts, "use")
        ]
        is_plain = len(shapes) == 1 and shapes[0].name in SHAPE_NAMES
        styles = [self._styles.of(part) for part in (clip, *shapes)]
        has_more = any(
            "clip-path" in one or "mask" in one or find_hiding_property(one)
            for one in styles
        )
        if (
            not is_plain
            or has_more
            or clip.attributes.get("clipPathUnits", "userSpaceOnUse")
            != "userSpaceOnUse"
        ):
            raise self._refusal(
                element,
                f"cut by {clip.label}, which is more than one shape",
                SVG_ADVICE.release,
            )
        for part in (clip, *shapes):
            scene = scene.transformed(
                parse_transforms(part.attributes.get("transform", ""))
            )
        corners = find_convex_corners(self._outline(shapes[0], scene))
        if corners is None:
            raise self._refusal(
                element, f"cut by {clip.label}, which is not convex", SVG_ADVICE.release
            )
        return (ClipOutline(corners, clip.label),)

    def _referred(self, value: str) -> SvgElement | str | None:
        """Return the element of url(#id), or another value as it is.

        Returns None for none, or for an unknown id.
        """
        if value in ("none", "", "inherit", *INITIAL_VALUES):
            return None
        if value.startswith("url(") and value.endswith(")"):
            name = value[4:-1].strip().strip("\"'").strip()
            if name.startswith("#"):
                return self._by_id.get(name[1:])
        return value

    def _note_page(self, element: SvgElement, strokes: list[Mat]) -> None:
        """Remark that a shape is beside the page: editors show it, browsers do not."""
        if self._page is None:
            return
        places = np.concatenate(strokes)
        corner = np.array(self._page.corner)
        if (places.max(axis=0) < corner).any() or (
            places.min(axis=0) > corner + self._page.size
        ).any():
            self.words.append(f"{element.label}: flown, though it is beside the page")

    def _leave_out(self, element: SvgElement, reason: str) -> None:
        """Remark that an element is left out, and why."""
        self.words.append(f"{element.label}: left out: {reason}")

    def _refusal(
        self,
        element: SvgElement,
        found: str,
        do: str = "",
        allowed: str = SVG_ADVICE.flown,
    ) -> ConfigError:
        """Return the error for an element that cannot be flown."""
        return ConfigError(self.where, f"{element.label} {found}".rstrip(), allowed, do)

    def _too_large(self, element: SvgElement) -> ConfigError:
        """Return the error for too many places."""
        found = f"more than {MOST_POINTS} places up to {element.label}"
        return ConfigError(
            self.where, found, f"at most {MOST_POINTS} places", "Simplify the drawing."
        )


def _is_chosen(child: SvgElement) -> bool:
    """Return whether a <switch> shows this child if no child before it is shown."""
    asks = ("requiredExtensions", "systemLanguage")
    return bool(child.name) and not any(
        child.attributes.get(name, "").strip() for name in asks
    )


def _compute_widening(matrix: Mat) -> float:
    """Return the largest factor by which a transform stretches a length.

    It is the largest singular value.
    """
    (a, b), (c, d) = matrix[:2, :2].tolist()
    return 0.5 * (math.hypot(a + d, b - c) + math.hypot(a - d, b + c))
