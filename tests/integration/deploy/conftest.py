"""Fixtures of the runner loop: a fake server, and runners in this process."""

from tests.integration.runner_loop.conftest import runners as runners
from tests.integration.runner_loop.conftest import server as server
