"""The desk of an operator, without a page: a scenario that runs now, what was done by hand, and what else was tried."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from copy import deepcopy
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

from bayesftc.console.desk.actions import Action, faults_of, time_of, with_absolute_paths, with_actions, words_of
from bayesftc.console.desk.events import Events, What
from bayesftc.console.desk.lane import Lane
from bayesftc.controllers.registry import LEARNERS
from bayesftc.cosim.errors import ModelError, UnknownNameError, brief, did_you_mean
from bayesftc.scenario import Scenario, find_scenario
from bayesftc.scenario._files import read_toml
from bayesftc.scenario._written import toml

MOST_LANES = 3
MOST_BRANCHES = 8
MOST_ACTIONS = 200
MOST_STATES = 1600
MEMORY = 512 * 2**20

Progress = Callable[[int], None]


@dataclass(eq=False)
class Branch:
    """One course of the run.

    Attributes
    ----------
    name : str
        Its name, unique at the desk.
    parent : str or None
        The branch from which it was made; None for the first.
    since : int
        The step at which it was made.
    actions : tuple of Action
        All that was done by hand, in its order.
    lanes : list of Lane
        The scenario's own controller first.
    furthest : int
        The last step that it has reached.
    """

    name: str
    parent: str | None
    since: int
    actions: tuple[Action, ...]
    lanes: list[Lane]
    furthest: int = 0

    @property
    def k(self) -> int:
        """The last step of the lanes that still run, or else of the one that came furthest."""
        running = [lane.k for lane in self.lanes if lane.stopped is None]
        return min(running) if running else max(lane.k for lane in self.lanes)

    @property
    def stopped(self) -> bool:
        """Whether no lane can continue."""
        return all(lane.stopped is not None for lane in self.lanes)

    def actions_until(self, k: int) -> tuple[Action, ...]:
        """Return the actions that were made up to step `k`."""
        return tuple(action for action in self.actions if action.k <= k + 1)

    def advance_to(self, k: int, progress: Progress | None = None) -> None:
        """Continue all lanes to a step, with all actions of the branch."""
        for lane in self.lanes:
            lane.advance_to(k, progress)
        self.furthest = max(self.furthest, self.k)


@dataclass(frozen=True)
class Served:
    """The scenario that a desk begins with.

    Attributes
    ----------
    file : Path
        Its file, for messages and for relative paths.
    content : mapping
        The content of the file, or one that was changed.
    name : str
        What the page shows.
    duration : Fraction
        Seconds that have run when the desk opens.
    """

    file: Path
    content: Mapping[str, Any]
    name: str
    duration: Fraction = Fraction(0)

    @classmethod
    def of(cls, path: str | Path) -> Served:
        """Return a scenario file, or a shipped scenario.

        Raises
        ------
        ScenarioError
            If there is none.
        """
        file = find_scenario(path)
        return cls(file, read_toml(file), file.stem)


@dataclass
class Desk:
    """A scenario that runs now, and what an operator does.

    Each action becomes an entry of the scenario, from the next step on. The edited scenario runs from its beginning to the
    present step, with the same bits as before, and continues from there. So the file that `toml` returns has the bits of this
    run, for ``bayesftc run``.

    Parameters
    ----------
    scenario_file : str, Path or Served
        The scenario file, the name of a shipped scenario, or its content.
    beside : sequence of str
        Kinds of precision learners: the scenario's controller runs beside itself with each of them.
    memory : int
        Bound of memory in bytes for recorded rows and saved states of all branches together.
    events : Events
        Where actions, alarms and branches are noted.

    Raises
    ------
    BayesFTCError
        If the scenario is wrong, or has no controller with such a learner.

    Examples
    --------
    >>> from bayesftc.console.desk.desk import Desk
    >>> with Desk("cruise_control", beside=()) as desk:
    ...     desk.advance_to(100)
    ...     desk.act("fault", "sensors", {"kind": "Dropout", "sensor": 1, "duration": 0.5})
    ...     desk.advance_to(150)
    ...     desk.branch.lanes[0].content["faults"][-1]
    {'kind': 'Dropout', 'sensor': 1, 'duration': 0.5, 'start': 2.02, 'name': 'dropout_1'}
    """

    scenario_file: str | Path | Served
    beside: Sequence[str] = ("FixedPrecision",)
    memory: int = MEMORY
    events: Events = field(default_factory=Events)
    branches: dict[str, Branch] = field(default_factory=dict, init=False)
    epoch: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        given = self.scenario_file
        served = given if isinstance(given, Served) else Served.of(given)
        self.file, self.content, self.name = served.file, served.content, served.name
        first = Lane("", self.content, self.file, self.memory)
        try:
            self.scenario: Scenario = first.scenario  # the one without actions
            self.variants = _variants(self.content, self.scenario, self.beside)
            first.name = next(iter(self.variants))
            lanes = [first, *self._lanes((), list(self.variants)[1:])]
        except BaseException:
            first.close()
            raise
        self.branch = Branch("first", None, 0, (), lanes)
        self.branches["first"] = self.branch
        self._share()
        self.compared: Branch | None = None
        self.epoch = 1
        self.advance_to(int(served.duration / self.step))

    @property
    def step(self) -> Fraction:
        """The base step in seconds."""
        return self.branch.lanes[0].step

    @property
    def k(self) -> int:
        """The present step."""
        return self.branch.k

    @property
    def time(self) -> float:
        """The time of the present step in seconds."""
        return time_of(self.k, self.step)

    @property
    def actions(self) -> tuple[Action, ...]:
        """What was done by hand in the present branch up to the present moment."""
        return self.branch.actions_until(self.k)

    def advance_to(self, k: int) -> None:
        """Continue to step `k`, the compared branch too; see `go_on`."""
        if k > self.k:
            self.go_on()
        before = self.k, self.branch.stopped
        self.branch.advance_to(k)
        self._note_alarms(*before)
        if self.compared is not None:
            self.compared.advance_to(self.branch.k)

    def act(
        self,
        what: str,
        target: str,
        settings: Mapping[str, Any] | None = None,
        value: float = 0.0,
        progress: Progress | None = None,
    ) -> Branch:
        """Do something by hand, from the next step on; see `Action`.

        At an earlier moment than the furthest it makes a new branch.

        Raises
        ------
        BayesFTCError
            If it cannot be done. The run then continues as before.
        """
        if what not in ("fault", "repair", "goal", "input"):
            raise ModelError(f"There is no action {brief(what)}; use fault, repair, goal or input.")
        if self.k < 0:
            raise ModelError("The run has not begun; advance it first.")
        if len(self.actions) >= MOST_ACTIONS:
            raise ModelError(
                f"There are {len(self.actions)} actions, which is the most. Save the scenario, and serve that file."
            )
        action = Action(self.k + 1, what, target, dict(settings or {}), value)  # type: ignore[arg-type]
        self._begin_again((*self.actions, action), progress)
        self.note("action", words_of(action))
        return self.branch

    def go_on(self, progress: Progress | None = None) -> None:
        """Leave the actions of later moments to the branch in which they were made.

        After `go_back` to a moment before some of them, the run continues without them, as a new branch.

        Raises
        ------
        ModelError
            If there are too many branches.
        """
        if len(self.actions) < len(self.branch.actions):
            self._begin_again(self.actions, progress)

    def _begin_again(self, actions: tuple[Action, ...], progress: Progress | None) -> None:
        """Let the run begin again with these actions, up to the present step; as a new branch if this one came further."""
        k, branch = self.k, self.branch
        is_new = k < branch.furthest
        if is_new:
            self._check_room()
        lanes = self._lanes(actions)
        try:
            for lane in lanes:
                lane.advance_to(k, progress)
        except BaseException:
            _close(lanes)
            raise
        if is_new:
            name = next(n for i in range(2, 10**6) if (n := f"branch {i}") not in self.branches)
            self.branch = self.branches[name] = Branch(name, branch.name, k, actions, lanes, k)
            self.note("branch", f"{name} begins, from {branch.name}")
        else:
            _close(branch.lanes)
            branch.actions, branch.lanes = actions, lanes
        self._share()
        self.epoch += 1

    def go_back(self, k: int) -> None:
        """Return to an earlier step of this branch; see `go_on`.

        Raises
        ------
        ModelError
            If there is no such step.
        """
        if not 0 <= k <= self.branch.furthest:
            raise ModelError(f"Step {k} is not in this branch, which has the steps 0 to {self.branch.furthest}.")
        for lane in self.branch.lanes:
            if k < lane.k or lane.stopped:
                lane.go_back(min(k, lane.k))
            lane.advance_to(k)
        self.note("action", "back to this time")
        self.epoch += 1

    def choose(self, name: str, progress: Progress | None = None) -> None:
        """Continue with another branch, where it came furthest. If it is the compared one, the two change places."""
        chosen = self._named(name)
        chosen.advance_to(chosen.furthest, progress)
        before, self.branch = self.branch, chosen
        if self.compared is self.branch:
            self.compared = None if before is self.branch else before
            before.advance_to(self.branch.k)
        self.note("branch", f"{name} is shown")
        self.epoch += 1

    def compare(self, name: str | None) -> None:
        """Compare the present branch with another one, which continues to the same step; None to end it."""
        branch = None if name is None else self._named(name)
        if branch is self.branch:
            raise ModelError(f"{name!r} is the present branch. Compare it with another one.")
        if branch is not None:
            branch.advance_to(self.branch.k)
        self.compared = branch
        self.note("branch", "the comparison ends" if name is None else f"{name} is compared")
        self.epoch += 1

    def rename(self, name: str, new: str) -> None:
        """Give a branch another name."""
        branch = self._named(name)
        new = " ".join(new.split())
        if not 0 < len(new) <= 40 or not new.isprintable() or (new in self.branches and new != name):
            raise ModelError(f"A branch cannot have the name {brief(new)}; use 1 to 40 characters that no branch has.")
        branch.name = new
        self.branches = {each.name: each for each in self.branches.values()}
        for each in self.branches.values():
            each.parent = new if each.parent == name else each.parent
        self.note("branch", f"{name} has the new name {new}")
        self.epoch += 1

    def remove(self, name: str) -> None:
        """Close a branch that is not the present one."""
        branch = self._named(name)
        if branch is self.branch:
            raise ModelError(f"{name!r} is the present branch. Choose another one first.")
        if self.compared is branch:
            self.compared = None
        del self.branches[name]
        _close(branch.lanes)
        self._share()
        self.note("branch", f"{name} is removed")
        self.epoch += 1

    def note(self, what: What, words: str) -> None:
        """Note an event at the present moment."""
        self.events.add(what, words, self.branch.name, self.time)

    def _note_alarms(self, k: int, was_stopped: bool) -> None:
        """Note the alarms after step `k`, and a run that has stopped since."""
        branch = self.branch
        several = len(branch.lanes) > 1
        for lane in branch.lanes:
            controller = f" ({lane.name})" if several else ""
            for alarm in lane.watch.after(k):
                self.events.add(
                    "alarm", lane.watch.words_of(alarm) + controller, branch.name, time_of(alarm.k, self.step)
                )
        if branch.stopped and not was_stopped:
            self.note("run", f"stopped: {branch.lanes[0].stopped}")

    def toml(self) -> str:
        """Return the scenario of the present branch up to the present step, as the text of a file."""
        return toml(self.scenario_content())

    def scenario_content(self, lane: int = 0) -> dict[str, Any]:
        """Return the content of a lane's scenario up to the present step, with the present time as its duration."""
        content = with_absolute_paths(
            self._content(self.actions, list(self.variants)[lane]), self.file.absolute().parent
        )
        end = max(self.k, 1)
        content["simulation"] = {**content["simulation"], "duration": time_of(end, self.step)}
        return content

    def close(self) -> None:
        """End all runs."""
        with ExitStack() as stack:
            for branch in self.branches.values():
                for lane in branch.lanes:
                    stack.callback(lane.close)

    def __enter__(self) -> Desk:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _lanes(self, actions: Sequence[Action], names: Sequence[str] | None = None) -> list[Lane]:
        """Return new lanes at their beginning: all, or those of some variants."""
        lanes: list[Lane] = []
        try:
            for name in self.variants if names is None else names:
                lanes.append(Lane(name, self._content(actions, name), self.file, self._part(len(self.variants))))
        except BaseException:
            _close(lanes)
            raise
        return lanes

    def _part(self, more: int = 0) -> int:
        """Return the memory of each lane of all branches, and of some more."""
        return self.memory // (sum(len(branch.lanes) for branch in self.branches.values()) + more)

    def _share(self) -> None:
        """Give each lane of all branches the same part of memory, and of the number of states."""
        part = self._part()
        for branch in self.branches.values():
            for lane in branch.lanes:
                lane.bound(part, MOST_STATES * part // self.memory)

    def _content(self, actions: Sequence[Action], name: str) -> dict[str, Any]:
        """Return the content of a variant's scenario with actions."""
        content = self.variants[name]
        return with_actions(content, actions, self.step, self.scenario) if actions else content

    def faults(self) -> list[tuple[str, str, dict[str, Any]]]:
        """Return the faults that are known at the present moment; see `faults_of`."""
        return faults_of(self._content(self.actions, next(iter(self.variants))))

    def _named(self, name: str) -> Branch:
        if name not in self.branches:
            raise UnknownNameError(f"There is no branch {brief(name)}; {did_you_mean(name, self.branches)}")
        return self.branches[name]

    def _check_room(self) -> None:
        if len(self.branches) >= MOST_BRANCHES:
            raise ModelError(f"There are {len(self.branches)} branches, which is the most. Remove one first.")


def _close(lanes: Sequence[Lane]) -> None:
    for lane in lanes:
        lane.close()


def check_learners(kinds: Iterable[str]) -> None:
    """Refuse names that are not those of precision learners.

    Raises
    ------
    UnknownNameError
        If there is no learner of one of the names.
    """
    known = [learner.__name__ for learner in LEARNERS]
    for kind in kinds:
        if kind not in known:
            raise UnknownNameError(f"There is no precision learner {kind!r}; {did_you_mean(kind, known)}")


def _variants(content: Mapping[str, Any], scenario: Scenario, beside: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the content of each lane by its name: the scenario, and the scenario with other learners."""
    precision = getattr(scenario.controller, "precision", None)
    own = "the scenario" if precision is None else type(precision).__name__
    lanes = {own: deepcopy(dict(content))}
    check_learners(beside)
    for kind in beside:
        if kind == own or precision is None:
            continue
        other = deepcopy(dict(content))
        other["controller"] = {**other["controller"], "precision": {"kind": kind}}
        lanes[kind] = other
    if len(lanes) > MOST_LANES:
        raise ModelError(f"There are {len(lanes)} controllers to compare, but at most {MOST_LANES} fit side by side.")
    return lanes


__all__ = ["MEMORY", "Branch", "Desk", "Served", "check_learners"]
