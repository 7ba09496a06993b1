"""The visible parts of an SVG document, drawn with transforms, styles, viewports and clips."""

from dataclasses import replace

import numpy as np

from crazychoir.planning.drawing.svg_clip import ClipOutline
from crazychoir.planning.drawing.svg_clip_reader import ClipReader
from crazychoir.planning.drawing.svg_document import (
    SVG_LIMITS,
    SvgElement,
    index_by_id,
    quote_text,
    shorten_text,
)
from crazychoir.planning.drawing.svg_outline import ShapeOutlines
from crazychoir.planning.drawing.svg_report import SVG_ADVICE, SvgReport
from crazychoir.planning.drawing.svg_scene import ELEMENT_NAMES, ElementScene
from crazychoir.planning.drawing.svg_shapes import (
    LENGTH_UNITS,
    SHAPE_NAMES,
    UNITS_PER_MILLIMETRE,
    ShapeError,
    SvgPage,
    compute_view,
    parse_length,
    parse_transforms,
    read_page,
)
from crazychoir.planning.drawing.svg_strokes import VisibleStrokes
from crazychoir.planning.drawing.svg_style import (
    INITIAL_VALUES,
    StyleSheets,
    find_hiding_property,
    is_visible,
    select_inherited,
)
from crazychoir.types import Mat

MOST_DRAWN_ELEMENTS = 50_000
"""Largest number of elements that are drawn; each counts as often as it is used."""
SCALE_TOLERANCE = 0.01
"""Share by which the page's millimetres may differ from the flown ones without a remark."""


class SvgReader:
    """Walks through a document and draws each element in its surroundings.

    root: of the document
    where: name of the document in errors
    scale: m a unit
    Raises ConfigError for styles or a page that cannot be read, and ArithmeticError for numbers
    that are too large.
    """

    def __init__(self, root: SvgElement, where: str, scale: float) -> None:
        self._root = root
        self._report = SvgReport(where)
        self._styles = StyleSheets(root, where)
        self._by_id = index_by_id(root)
        self._page = _read_page(root, scale, self._report)
        outlines = ShapeOutlines(scale, self._report)
        self._clips = ClipReader(self._styles, self._by_id, outlines, self._report)
        self._visible = VisibleStrokes(outlines, self._page, self._report)
        self._visits = 0

    @property
    def strokes(self) -> list[Mat]:
        """The visible strokes, (k, 2) rows in units of the picture."""
        return self._visible.strokes

    @property
    def words(self) -> list[str]:
        """Remarks on the rest."""
        return self._report.words

    def read(self) -> None:
        """Draw the whole document.

        Raises ConfigError for what cannot be flown, and ArithmeticError for numbers that are too
        large.
        """
        size = self._page.size if self._page else None
        self._draw(self._root, ElementScene(np.eye(3), {}, size))

    def _draw(self, element: SvgElement, scene: ElementScene) -> None:
        """Draw an element if it is drawn at all."""
        self._visits += 1
        if self._visits > MOST_DRAWN_ELEMENTS:
            raise self._report.build_refusal(
                element,
                f"as one of more than {MOST_DRAWN_ELEMENTS} elements",
                "Use fewer copies.",
            )
        if scene.depth > SVG_LIMITS.nesting:
            raise self._report.build_refusal(
                element,
                f"within more than {SVG_LIMITS.nesting} others",
                "Ungroup the drawing.",
            )
        if not element.name or element.name in ELEMENT_NAMES.definitions:
            return
        if element.name in ELEMENT_NAMES.animations:
            self._report.leave_out(element, "changes with time are not flown")
        elif element.name not in (
            *SHAPE_NAMES,
            *ELEMENT_NAMES.containers,
            *ELEMENT_NAMES.texts,
            *ELEMENT_NAMES.pictures,
        ):
            self._report.leave_out(element, "no element that is drawn")
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
            self._report.leave_out(element, reason)
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
                self._report.leave_out(element, "its transform leaves it no size")
                return
            scene = replace(
                scene, clips=scene.clips + self._clips.read_clips(element, style, scene)
            )
            if element.name in SHAPE_NAMES:
                self._visible.add_shape(element, style, scene)
            elif element.name == "use":
                self._draw_use(element, scene)
            elif element.name == "symbol" or (
                element.name == "svg" and element is not self._root
            ):
                self._draw_view(element, style, scene, given)
            else:
                self._draw_children(element, scene)
        except ShapeError as error:
            raise self._report.build_refusal(
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
            raise self._report.build_refusal(
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
            self._report.leave_out(element, "nothing of it is seen")
            return
        do = (
            "Turn it into a path (Inkscape: Path, Object to Path)"
            if is_text
            else "Trace it as a path"
        )
        raise self._report.build_refusal(element, "", f"{do}, hide it, or delete it.")

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
            self._report.leave_out(element, "it has no size")
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
            raise self._report.build_refusal(
                element,
                f"of {quote_text(link)}, which is another file",
                SVG_ADVICE.unlink,
            )
        target = self._by_id.get(link[1:])
        if target is None:
            self._report.leave_out(
                element, f"nothing in the file has the id {quote_text(link[1:])}"
            )
            return
        if link in scene.users:
            raise self._report.build_refusal(
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


def _is_chosen(child: SvgElement) -> bool:
    """Return whether a <switch> shows this child if no child before it is shown."""
    asks = ("requiredExtensions", "systemLanguage")
    return bool(child.name) and not any(
        child.attributes.get(name, "").strip() for name in asks
    )


def _read_page(root: SvgElement, scale: float, report: SvgReport) -> SvgPage | None:
    """Return the page of a document, or None if it declares none.

    Remarks that a unit of the page in millimetres differs from the unit that is flown.

    scale: m a unit
    Raises ConfigError for a page that cannot be read.
    """
    try:
        page = read_page(root)
        width = root.attributes.get("width", "").strip().lower()
        physical = tuple(unit for unit in LENGTH_UNITS if unit not in ("", "px"))
        if page is None or not page.size[0] > 0.0 or not width.endswith(physical):
            return page
        unit = parse_length(root, "width", None) / UNITS_PER_MILLIMETRE / page.size[0]
    except ShapeError as error:
        raise report.build_refusal(
            root, f"with {error.found}", allowed=error.allowed
        ) from error
    flown = 1000.0 * scale
    if abs(unit / flown - 1.0) > SCALE_TOLERANCE:
        report.note(f"on the page a unit is {unit:.4g} mm; flown it is {flown:.4g} mm")
    return page
