"""The logs of the server's processes: their format and levels, and the errors that end a process."""

import logging
import sys
import threading
import types
from typing import Literal

from kleinkram.json_logs import JsonLines


def set_up_logs(log_format: Literal["json", "text"], level: Literal["debug", "info", "warning"], *, role: str) -> None:
    """Log to stderr: our own lines from `level` on, and only warnings of libraries that log URLs."""
    handler = logging.StreamHandler(sys.stderr)
    text = logging.Formatter("%(asctime)s %(levelname)s %(name)s %(message)s")
    handler.setFormatter(JsonLines(role) if log_format == "json" else text)
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    logging.getLogger("kleinkram").setLevel(level.upper())
    logging.captureWarnings(True)
    sys.excepthook = _log_crash
    threading.excepthook = lambda ended: _log_crash(ended.exc_type, ended.exc_value, ended.exc_traceback)
    quiet_libraries()


def _log_crash(kind: type[BaseException], error: BaseException | None, traceback: types.TracebackType | None) -> None:
    """Log the error that ends the process or a thread."""
    if error is not None and not isinstance(error, KeyboardInterrupt):
        logging.getLogger("kleinkram").critical(
            f"ended by an error: {kind.__name__}: {error}", exc_info=(kind, error, traceback)
        )


def quiet_libraries() -> None:
    """Log only warnings of libraries that log URLs."""
    for noisy in ("aiohttp", "uvicorn.access", "alembic", "procrastinate", "httpx"):
        logging.getLogger(noisy).setLevel(logging.WARNING)
