"""One drone, or several side by side, fly a hand-drawn path, by default the word "Casy", or a trajectory.

crazychoir run drawn_path --fast --picture out/casy.png
"""

from pathlib import Path
from typing import Any

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.config.tables import Text
from crazychoir.guidance.defaults.drawings import DrawingHooks, DrawingOptions
from crazychoir.guidance.timed import Way, record_way
from crazychoir.planning.drawing.drawing import Drawing


class Options(DrawingOptions, frozen=True, kw_only=True):
    """[mission_options]: also scale, yaw, timing, lift, height and slower."""

    drawing: Text = str(Path(__file__).parent / "data" / "casy.csv")
    """A CSV file of rows stroke, t, x, y, or of rows duration, x^0 ... yaw^7 (a trajectory), or an SVG
    picture with a unit of 1 mm.
    """


hooks = DrawingHooks(Options)
swarm = hooks.swarm
check = hooks.check
report = hooks.report
picture = hooks.picture


class Writer(CFGuidance):
    """Flies a drawing."""

    def __init__(self, drawn: Drawing) -> None:
        self.drawn = drawn
        self.way = Way()

    async def mission(self) -> dict[str, Any]:
        """Take off, fly along the drawing, go home, land."""
        await self.take_off()
        await self.rendezvous()
        home = self.state.p.copy()
        await self.go_to(self.drawn.path.sample(0.0).p)
        async with record_way(self, self.way):
            await self.fly(self.drawn.path)
        await self.go_to(home)
        await self.land()
        return {"place": self.state.p.tolist(), "way": self.way.rows}


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the guidance of drone i: it writes over its home."""
    return Writer(hooks.drawing(config, i))
