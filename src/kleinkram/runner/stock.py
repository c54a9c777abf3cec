"""The image that scripts run on, which may be there only later: looked for until it is."""

import logging
import threading
import time
from collections.abc import Callable

from kleinkram.contract.errors import KleinkramError
from kleinkram.runner.work import CannotStart, Executor

_AGAIN_S = 300.0
_log = logging.getLogger("kleinkram.runner")


class DefaultImage:
    """Looks for it in a thread of its own. `found` is called once it is there; `digest` then is its."""

    def __init__(self, executor: Executor, name: str | None, found: Callable[[], None]) -> None:
        self._executor = executor
        self._name = name if executor.abilities.images else None
        self._found = found
        self.digest: str | None = None

    def start(self) -> None:
        """Begin to look; nothing happens where scripts run on no image."""
        if self._name is not None:
            threading.Thread(target=self._look, args=(self._name,), name="stock", daemon=True).start()

    def _look(self, name: str) -> None:
        is_said = False
        while True:
            try:
                self.digest = self._executor.prepare(name).digest
                self._found()
                return
            except CannotStart as error:
                if not is_said:
                    _log.warning("no script can be run yet: %s", error)
                is_said = True
            except KleinkramError as error:
                _log.warning("the server does not know of the default image yet: %s", error)
            time.sleep(_AGAIN_S)
