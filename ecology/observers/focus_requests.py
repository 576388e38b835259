"""Requests for the agent in focus: clicks in a browser, and `ecology focus`.

A run reads its requests at its samples, so a request never blocks or disturbs it. Clicks come from another
thread of the same process. Words come from another process, by a file in the run's folder that the run answers in.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from ecology.errors import EcologyError
from ecology.observers.mailbox import PATIENCE, PAUSE, Mailbox, request

AGENTS = "/world/agents"  # below it every species is an entity whose instances are its slots
KIND, FILE = "focus", "focus.json"  # of requests, and in the run's folder while somebody waits for an answer
KEPT = 16  # clicks that may wait for a sample; of more, the last


@dataclass(frozen=True)
class Click:
    """What was selected in a viewer."""

    entity: str  # path, as /world/agents/prey
    row: int  # of the entity's instances, at least 0
    tick: float | None = None  # that was shown; None where it is not known


class FocusRequests:
    """The requests for one run; `click` may be called from any thread."""

    def __init__(self, folder: Path | None = None) -> None:
        """Take clicks, and with a `folder` the words that `request_focus` leaves there from now on."""
        self._clicks: deque[Click] = deque(maxlen=KEPT)
        self._names: deque[tuple[str, Future[str]]] = deque()
        self._mailbox = None if folder is None else Mailbox(folder, KIND)

    def click(self, click: Click) -> None:
        """Request the agent that was clicked."""
        self._clicks.append(click)

    def hear(self, click: Click) -> None:
        """Request the agent that was clicked; nothing is drawn at once."""
        self.click(click)

    def name(self, word: str, patience: float = PATIENCE) -> str:
        """Request `word` from another thread and return what the run says; EcologyError if it refuses."""
        answer: Future[str] = Future()
        self._names.append((word, answer))
        try:
            return answer.result(patience)
        except TimeoutError as error:
            raise EcologyError("the run has not answered; it is slow, or over.") from error

    def words(self) -> list[tuple[str, Callable[[str, bool], None]]]:
        """Return the words that wait, each with what takes its answer and whether it was done."""
        found: list[tuple[str, Callable[[str, bool], None]]] = []
        while self._names:
            word, waits = self._names.popleft()

            def tell(said: str, done: bool, waits: Future[str] = waits) -> None:
                if done:
                    waits.set_result(said)
                else:
                    waits.set_exception(EcologyError(said))

            found.append((word, tell))
        if (asked := self.word()) is not None:

            def reply(said: str, done: bool, asked: str = asked) -> None:
                self.answer(asked, said, done=done)

            found.append((asked, reply))
        return found

    def clicks(self) -> list[Click]:
        """Return the clicks since the last time."""
        found = []
        while self._clicks:
            found.append(self._clicks.popleft())
        return found

    def word(self) -> str | None:
        """Return the word that waits for an answer, None without one."""
        return None if self._mailbox is None else self._mailbox.waiting()

    def answer(self, word: str, said: str, *, done: bool) -> None:
        """Answer the request for `word`."""
        if self._mailbox is not None:
            self._mailbox.answer(word, said, done=done)


def request_focus(folder: Path, word: str, lives: Callable[[], bool], patience: float = PATIENCE) -> str:
    """Request `word` of the run in `folder`, which `lives`; return what it says.

    Raises EcologyError if the run refuses, has ended or does not answer.
    """
    return request(
        folder,
        KIND,
        word,
        lives,
        ended=f"of one that was recorded, look by `ecology view {folder} --focus {word}`.",
        silent="it is slow, or neither recorded nor watched; ask again, or start it with --view or --serve.",
        patience=patience,
        pause=PAUSE,
    )
