"""Commitments: each task is served once, also if messages are lost and robots are killed, cut off or started again.

The robots have no bodies. Each robot has its news, its commitments and its plannings, as in flight. Chance decides
which robot has its turn, which message is lost, and which fault a robot meets. The test keeps the true state of the
goods apart from what the robots believe.
"""

from collections import Counter
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from crazychoir.guidance.delivery.commitments import Commitments
from crazychoir.guidance.delivery.replanning import Replanning, identify_tasks
from crazychoir.guidance.tasks.task_book import Fate, Task
from crazychoir.guidance.tasks.team_news import TeamNews
from crazychoir.routing.instance.generate import random_instance
from crazychoir.team.graph import graph_from_name

OWN = random_instance(4, 1, 0).local(0)
HERE, PUT, DONE, GONE = (
    "where it lies",
    "put where it belongs, and nobody may know",
    "delivered",
    "gone",
)
FAULTS, STEPS = 600, 30_000
"""Turns in which faults may happen, and turns within which all robots must have ended."""


@dataclass(eq=False)
class Robot:
    """One robot: its id, what it knows and has promised; at: the stop that it has announced, and the edition."""

    id: int
    incarnation: int
    news: TeamNews
    commitments: Commitments
    key: tuple = ()
    runs: int = 0
    program: Replanning | None = None
    mark: tuple | None = None
    at: tuple | None = None
    aboard: list[int] = field(default_factory=list)
    sent: dict = field(default_factory=dict)


class Team:
    """All robots, the goods as they are, and chance."""

    def __init__(self, seed, robots=4, tasks=10, recover=False):
        self.draw = np.random.default_rng(seed)
        self.recover, self.epoch, self.turn = recover, 0, 0
        points = self.draw.uniform(0.0, 9.0, size=(tasks, 2, 2)).tolist()
        whole = [
            Task(j, 0, False, tuple(a), tuple(b)) for j, (a, b) in enumerate(points)
        ]
        self.tasks, self.later = whole[: tasks // 2], whole[tasks // 2 :]
        self.asked, self.promised = [], {task.id for task in self.tasks}
        self.goods, self.delivered = dict.fromkeys(range(tasks), HERE), Counter()
        self.members = tuple(range(robots))
        self.robots = {
            i: self.started(i, int(self.draw.integers(1 << 40))) for i in self.members
        }
        self.rounds = {}  # messages of plannings that have arrived: (to, from, key, run, round)
        self.cut = None
        self.stray = {}  # task: the last robot that may have moved its goods
        self.taken_back, self.too_late = (
            [],
            [],
        )  # tasks with pickups that were taken back; these tasks when the team heard of them only at its end

    def started(self, i, incarnation):
        port = SimpleNamespace(
            incarnation=incarnation,
            bus=SimpleNamespace(clock=SimpleNamespace(now=lambda: 0.0)),
        )
        communicator = SimpleNamespace(
            id=i,
            port=port,
            graph=graph_from_name("complete", self.members),
            epoch=self.epoch,
        )
        news = TeamNews(
            communicator, tuple(self.tasks), lambda: (0.0, 0.0), self.recover
        )
        return Robot(i, incarnation, news, Commitments(news))

    @property
    def living(self):
        return list(self.robots.values())

    def linked(self, i, j):
        return self.cut not in (i, j)

    # What happens to it ---------------------------------------------------------------------------------------

    def kill(self, i):
        self.let_fall(self.robots.pop(i))

    def let_fall(self, robot):
        """End the robot here: the goods aboard lie here, and so do goods that it was about to pick up or deliver."""
        if robot.at is not None and robot.at[0].kind == "delivery":
            self.put(robot, robot.at[0].task)
        for j in robot.aboard:
            self.goods[j] = HERE if self.recover else GONE
            self.stray[j] = robot.id
        if robot.at is not None and robot.at[0].kind == "pickup":
            self.stray[robot.at[0].task] = robot.id
        robot.aboard.clear()
        robot.at = None

    def put(self, robot, j):
        """Deliver goods; robots that never hear of it may come for the goods."""
        robot.aboard.remove(j)
        robot.at = None
        self.goods[j], self.stray[j] = PUT, robot.id

    def restart(self, i):
        self.robots[i] = self.started(i, int(self.draw.integers(1 << 40)))

    def change(self, members, who=None):
        """Begin a new epoch of these members; all robots hear of it, or only some."""
        self.epoch += 1
        for robot in self.living if who is None else who:
            robot.news.communicator.graph = graph_from_name("complete", members)
            robot.news.communicator.epoch = self.epoch

    def fault(self):
        dead = [i for i in self.members if i not in self.robots]
        what = self.draw.choice(
            ["kill", "restart", "cut", "heal", "notice", "task", "task", "cancel"]
        )
        if what == "kill" and len(self.robots) > 2 and self.cut is None and not dead:
            self.kill(int(self.draw.choice(list(self.robots))))
        elif what == "restart" and dead:
            self.restart(dead[0])
            self.change(tuple(sorted(self.robots)))
        elif what == "cut" and self.cut is None and not dead:
            self.cut = int(self.draw.choice(list(self.robots)))
        elif what == "heal":
            self.heal()
        elif what == "notice":
            self.notice()
        elif what == "task" and self.later:
            self.add(self.robots[int(self.draw.choice(list(self.robots)))])
        elif what == "cancel":
            book = self.robots[int(self.draw.choice(list(self.robots)))].news.book
            book.cancel(int(self.draw.choice(list(book.tasks))))

    def add(self, robot):
        """Add a task like TaskSource."""
        news = robot.news
        may_end = robot.commitments.planning and news.record.idle
        if news.known(1) and not may_end and not news.ended and not news.record.out:
            task = self.later.pop()
            news.book.learn(task)
            self.asked.append((robot, news.say(), task.id))

    def acknowledge(self):
        """A task is promised when more than half of the team know of it."""
        for robot, number, j in self.asked:
            if robot in self.living and robot.news.known(number):
                self.promised.add(j)

    def notice(self):
        """Remove dead and cut-off robots from the team; a robot that is cut off becomes a team of its own."""
        part = tuple(i for i in sorted(self.robots) if i != self.cut)
        if part != self.robots[part[0]].news.members:
            self.change(part, [self.robots[i] for i in part])
        if self.cut is not None and self.robots[self.cut].news.members != (self.cut,):
            self.change((self.cut,), [self.robots[self.cut]])

    def heal(self):
        cut, self.cut = self.cut, None
        if any(robot.news.ended for robot in self.living):
            self.too_late = list(self.taken_back)
        if cut is not None and self.robots[cut].news.members == (cut,):
            self.change(tuple(sorted(self.robots)))

    # A robot's turn -------------------------------------------------------------------------------------------

    def gossip(self, robot):
        letter = robot.news.letter()
        for other in self.living:
            there = other.id in robot.news.members and self.linked(robot.id, other.id)
            if other is not robot and there and self.draw.random() > 0.4:
                other.news.hear({robot.id: letter})

    def fly(self, robot):
        """Follow the stops like OnlinePDVRPGuidance, but without the way."""
        news, commitments = robot.news, robot.commitments
        if robot.at is not None:
            self.stand(robot, *robot.at)
        elif not news.ended:
            stop = commitments.next()
            if stop is None:
                if not news.record.idle and not news.record.out:
                    news.say(idle=True)
            elif commitments.allow(stop):
                if stop.kind == "delivery":
                    assert stop.task in robot.aboard, (
                        "it delivers what it does not have"
                    )
                robot.at = stop, commitments.announce(stop)

    def stand(self, robot, stop, number):
        if robot.news.known(number):
            self.leave(robot, stop)
        elif not robot.news.quorate:
            if stop.kind == "pickup":
                robot.commitments.take_back(stop.task)
                self.taken_back.append(stop.task)
                robot.at = None
            elif self.recover:
                self.put(robot, stop.task)
            else:
                self.leave(robot, stop)

    def leave(self, robot, stop):
        robot.at = None
        j = stop.task
        if stop.kind == "pickup":
            assert self.goods[j] in (HERE, PUT), (
                f"task {j} is {self.goods[j]}, and robot {robot.id} picks it up"
            )
            self.goods[j] = robot.id
            robot.aboard.append(j)
        else:
            self.put_down(robot, j)

    def put_down(self, robot, j):
        robot.aboard.remove(j)
        self.goods[j] = DONE
        self.delivered[j] += 1
        assert self.delivered[j] == 1, f"task {j} is delivered twice"

    def plan(self, robot):
        """A turn of its planning: to take part, or one round, if all messages of the last have arrived."""
        news, key = robot.news, robot.news.key()
        if key != robot.key:
            robot.key, robot.runs, robot.program, robot.sent = key, 0, None, {}
            if not news.count():
                self.cut_off(robot)
        if not news.quorate or robot.id in key[1] or news.ended:
            return
        self.send(robot)
        if robot.program is None:
            self.begin(robot, key)
        elif not robot.program.done:
            self.exchange(robot)
        if robot.program is not None and robot.program.done:
            share = robot.program.result
            robot.commitments.adopt(share)
            robot.mark, robot.program = identify_tasks(share.book), None

    def begin(self, robot, key):
        news = robot.news
        alive = news.book.alive(news.members).values()
        run = key[0], len(key[1]), robot.runs + 1
        begun = any(
            record.run[:2] == run[:2] and record.run[2] >= run[2] for record in alive
        )
        if robot.runs and not (
            begun
            or identify_tasks(news.book) != robot.mark
            or all(record.idle for record in alive)
        ):
            return
        robot.runs += 1
        news.say(run=run)
        head = []
        for stop in robot.commitments.route[: self.draw.integers(3)]:
            if not robot.commitments.allow(stop):
                break
            head.append(stop)
        bonds = robot.commitments.begin(head)
        graph = news.links(without=key[1])
        robot.program = Replanning(
            robot.id, graph, news.book, bonds, self.problem(robot), self.recover
        )
        robot.sent[robot.runs, 0] = robot.program.message()

    def problem(self, robot):
        """Its own: capacity 2, capable of everything; it is anywhere, so each plan may be another."""
        home, start = (
            np.array([2.0 * robot.id, 0.0]),
            self.draw.uniform(0.0, 9.0, size=2),
        )

        def of(goods):
            mine, free = np.array(goods.mine, bool), np.array(goods.free, bool)
            tasks = goods.public(1.0)
            return replace(
                OWN,
                robot=robot.id,
                home=home,
                start=start,
                capacity=2.0,
                tasks=tasks,
                aboard=mine,
                capable=mine | free,
            )

        return of

    def send(self, robot):
        """Send all messages of the planning again, also after the robot has ended it: some may have been lost."""
        for j in robot.news.members:
            for (run, k), message in robot.sent.items():
                if self.linked(robot.id, j):
                    self.rounds[j, robot.id, robot.key, run, k] = message

    def exchange(self, robot):
        program = robot.program
        at = {
            j: (robot.id, j, robot.key, robot.runs, program.k)
            for j in program.graph.neighbors(robot.id)
        }
        if all(box in self.rounds for box in at.values()):
            program.step({j: self.rounds[box] for j, box in at.items()})
            if not program.done:
                robot.sent[robot.runs, program.k] = program.message()

    def cut_off(self, robot):
        if self.recover:
            robot.news.say(out=True)
            self.let_fall(robot)
        robot.commitments.keep_aboard()

    # All of it ------------------------------------------------------------------------------------------------

    def run(self):
        """Until all have ended."""
        while not all(
            robot.news.ended or robot.news.record.out for robot in self.living
        ):
            self.turn += 1
            assert self.turn < STEPS, self.story()
            if self.turn < FAULTS and self.draw.random() < 0.02:
                self.fault()
            elif self.turn >= FAULTS and self.turn % 50 == 0:
                self.heal()
                self.notice()
            robot = self.living[self.draw.integers(len(self.robots))]
            (self.gossip, self.fly, self.plan)[self.draw.integers(3)](robot)
            self.acknowledge()
        for _ in range(20):
            for robot in self.living:
                self.gossip(robot)
        return self

    def story(self):
        return [
            (r.id, r.news.record, r.commitments.route, r.at, r.news.standings())
            for r in self.living
        ]


@pytest.mark.parametrize("recover", [False, True])
@pytest.mark.parametrize("seed", range(30))
def test_each_task_is_served_once_unless_it_is_lost_with_its_carrier(seed, recover):
    team = Team(seed, recover=recover).run()
    flying = [robot for robot in team.living if not robot.news.record.out]
    stories = [robot.news.standings() for robot in flying]
    assert all(story == stories[0] for story in stories), (
        "the robots tell of different ends"
    )
    assert team.promised <= set(stories[0]), "a promised task is forgotten"
    for j, standing in stories[0].items():
        if standing.fate is Fate.DELIVERED:
            assert team.goods[j] == PUT or team.delivered[j] == 1, (
                "said to be delivered"
            )
        elif standing.fate is Fate.CANCELLED:
            assert not team.delivered[j]
        else:
            late = j in team.too_late or j not in team.promised
            assert late or standing.fate is Fate.LOST, "no robot has served the task"
            assert late or not recover
            assert late or j in team.stray, "and no lost robot had its goods"
