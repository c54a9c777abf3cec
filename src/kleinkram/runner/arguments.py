"""The options of a runner process, and its token."""

import enum
import os
import sys
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from kleinkram.client.errors import ConfigurationBroken, CredentialsExposed, NotConfigured
from kleinkram.contract.names import Label
from kleinkram.runner.executors.gpus import GpuRequest
from kleinkram.runner.executors.kubernetes.options import KubernetesOptions
from kleinkram.runner.executors.slurm.options import SlurmOptions
from kleinkram.runner.images.names import Pull

DEFAULT_IMAGE = "kleinkram/action-python:latest"
TOKEN_VARIABLE = "KLEINKRAM_RUNNER_TOKEN"  # noqa: S105  the name of the variable


class ExecutorChoice(str, enum.Enum):
    """`auto`: containers where an engine answers that has, or can pull, the default image; else processes."""

    auto = "auto"
    docker = "docker"
    process = "process"


class ImageChoice(str, enum.Enum):
    """How processes run images. `auto`: as `namespaces` where the kernel allows them, else as `apptainer`.

    `auto` runs none where neither is possible, or the default image is not available.
    """

    off = "off"
    auto = "auto"
    namespaces = "namespaces"
    apptainer = "apptainer"


class Arguments(BaseModel):
    """The options of a runner. Its token is in `KLEINKRAM_RUNNER_TOKEN` or in a file.

    `package_index` is by default that of `KLEINKRAM_PACKAGE_INDEX`, else PyPI. With `slurm` or `kubernetes`, runs are
    jobs of a cluster, whatever `executor` is.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    url: str
    data_dir: Path
    name: Label
    token_file: Path | None = None
    labels: list[Label] = []
    cores: float | None = None
    memory_bytes: int | None = None
    disk_bytes: int | None = None
    cache_bytes: int | None = None
    cache_age_days: int | None = None
    environments_bytes: int | None = None
    package_index: str | None = None
    gpus: Annotated[int, Field(ge=0)] | Literal["all"] = 0
    gpu_names: list[str] = []
    gpu_sharing: Annotated[int, Field(ge=1)] = 1
    executor: ExecutorChoice = ExecutorChoice.auto
    images: ImageChoice = ImageChoice.off
    images_bytes: int | None = None
    slurm: SlurmOptions | None = None
    kubernetes: KubernetesOptions | None = None
    default_image: str = DEFAULT_IMAGE
    pull: Pull = Pull.missing
    registries: list[str] | None = None
    once: bool = False
    metrics_port: int | None = None
    metrics_address: str = "127.0.0.1"
    log_format: Literal["json", "text"] = "text"

    @property
    def gpu_request(self) -> GpuRequest:
        """The GPUs that the runner is to have."""
        return GpuRequest(None if self.gpus == "all" else self.gpus, tuple(self.gpu_names), self.gpu_sharing)

    def command(self) -> list[str]:
        """Return the command line of a runner with these options."""
        return [sys.executable, "-m", "kleinkram.runner", self.model_dump_json(exclude_defaults=True)]


def find_token(file: Path | None) -> str:
    """Return the token of the runner, from a file or from the environment.

    Raises:
        NotConfigured: there is none.
        CredentialsExposed: others can read the file.
        ConfigurationBroken: the file cannot be read.
    """
    if file is None:
        # Removed from the environment, so that child processes do not get it.
        token = os.environ.pop(TOKEN_VARIABLE, "")
        if not token:
            raise NotConfigured(reason=f"a runner needs its token, in {TOKEN_VARIABLE} or in a file (--token-file)")
        return token.strip()
    try:
        mode = file.stat().st_mode & 0o777
        if mode & 0o077:
            raise CredentialsExposed(file=str(file), mode=f"{mode:o}")
        return file.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationBroken(file=str(file), reason=str(error)) from error
