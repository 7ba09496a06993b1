"""Each drone flies a circle or an eight around its home, as exactly as it can.

crazychoir run figure --fast --drones 4 --picture out/figure.png
"""

from typing import Any

from crazychoir import CFGuidance, SwarmConfig
from crazychoir.guidance.defaults.figures import FigureHooks, FigureOptions
from crazychoir.guidance.timed import Way, record_way

Options = FigureOptions
hooks = FigureHooks(Options)
check = hooks.check
report = hooks.report
picture = hooks.picture


class Flown(CFGuidance):
    """Flies one figure."""

    async def mission(self) -> dict[str, Any]:
        """Take off, go to the start of the figure, fly it, go home, land."""
        config = self.member.config
        x, y, _ = config.drone(self.id).home
        figure = hooks.figure(config, self.id)
        await self.take_off()
        await self.rendezvous()
        await self.go_to(figure.sample(0.0).p)
        way = Way()
        async with record_way(self, way):
            await self.fly(figure)
        await self.go_to((x, y, self.state.p[2]))
        await self.land()
        return {"place": self.state.p.tolist(), "way": way.rows}


def guidance(i: int, config: SwarmConfig) -> CFGuidance:
    """Return the guidance of drone i: it flies around its home."""
    return Flown()
