"""Timeline: windows open and close, triggers trip and decisions fall as the events' own time passes."""

from __future__ import annotations

from async_tnt.decider import Decider
from async_tnt.decision import Decision
from async_tnt.events import Columns
from async_tnt.kernels.state import NEVER_US
from async_tnt.triggers import Triggers
from async_tnt.windows import OpenWindows


class Timeline:
    """What happens when, on one stream. It has nothing of its own to remember: the parts do.

    Parameters
    ----------
    windows : OpenWindows. Those that are open, and the grid that they lie on.
    triggers : Triggers. When to decide besides at the end of a window.
    decider : Decider. Who decides.
    """

    def __init__(self, windows: OpenWindows, triggers: Triggers, decider: Decider) -> None:
        self._windows, self._triggers, self._decider = windows, triggers, decider

    def take(self, columns: Columns) -> list[Decision]:
        """Add events; the decisions that fell meanwhile. What the classifier raises passes through."""
        windows = self._windows
        decisions: list[Decision] = []
        first, n = 0, columns.n
        while first < n:
            if not len(windows):
                self.open_windows(int(columns.t[first]))
            if self._triggers.look_at_events:
                first, new = self._decider.take(windows, self._triggers, columns, first, n)
                self._note(new, windows.oldest.newest_us, decisions)
            else:
                first = windows.take(columns, first, n)
            if first < n and len(windows):
                self.advance(int(columns.t[first]), decisions)
        return decisions

    def taken_one(self, decisions: list[Decision]) -> None:
        """The oldest window took one event by itself: decide where that makes a decision due, as `Decider.take`."""
        oldest, triggers = self._windows.oldest, self._triggers
        due = triggers.every_events is not None and oldest.n_events % triggers.every_events == 0
        if due or triggers.each_event:
            decision = self._decider.decide(oldest, "every_events" if due else "", level=triggers.confidence)
            if decision.trigger:
                self._note([decision], oldest.newest_us, decisions)

    def advance(self, t_us: int, decisions: list[Decision]) -> None:
        """Let time pass to `t_us`: trip triggers, close windows and open new ones on the way."""
        windows, triggers = self._windows, self._triggers
        while len(windows):
            end_us = windows.oldest_end_us
            if triggers.due_us <= t_us and triggers.due_us < end_us:
                new = []
                if windows.oldest.n_events > triggers.n_decided:
                    new.append(self._decider.decide(windows.oldest, "every_us", level=triggers.confidence))
                triggers.wait(min(t_us, end_us), windows.oldest.start_us)
                self._note(new, t_us, decisions)
            elif end_us <= t_us:
                if windows.oldest.n_events:  # first: should the classifier raise, the window stays open
                    decisions.append(self._decider.decide(windows.oldest, "window", complete=True))
                windows.close_oldest()
                self._begin_oldest(end_us)
            else:
                break
        self.open_windows(t_us)

    def open_windows(self, t_us: int) -> None:
        """Open what is due at `t_us`."""
        if self._windows.open_until(t_us):
            self._begin_oldest(max(t_us, self._windows.oldest.start_us))
        self._windows.limit(self._triggers.due_us)

    def wait_anew(self) -> None:
        """The triggers' settings have changed: the open window goes on by the new ones."""
        if len(self._windows):
            oldest = self._windows.oldest
            self._triggers.wait(max(oldest.start_us, oldest.newest_us), oldest.start_us)
            self._windows.limit(self._triggers.due_us)

    def finish(self) -> list[Decision]:
        """The stream is over: close all windows, and decide those that hold events."""
        decisions = []
        while len(self._windows):
            if self._windows.oldest.n_events:
                decisions.append(self._decider.decide(self._windows.oldest, "end"))
            self._windows.close_oldest()
        return decisions

    def _note(self, new: list[Decision], now_us: int, decisions: list[Decision]) -> None:
        """Take over decisions of the oldest window: after a complete one it is over."""
        if not new:
            return
        decisions += new
        self._triggers.n_decided = new[-1].events
        if new[-1].complete:
            self._windows.close_oldest(early=True)
            self._begin_oldest(now_us)
            if len(self._windows):
                self._windows.limit(self._triggers.due_us)

    def _begin_oldest(self, now_us: int) -> None:
        """From now on another window is the oldest, or none is open."""
        self._triggers.n_decided = 0
        self._triggers.due_us = NEVER_US
        if len(self._windows):
            self._triggers.wait(now_us, self._windows.oldest.start_us)
