"""The objects of the API of Kubernetes that runs need, with the fields that are read."""

import datetime

from pydantic import BaseModel, ConfigDict, Field
from pydantic.alias_generators import to_camel


class ApiObject(BaseModel):
    """An object. Other fields are ignored."""

    model_config = ConfigDict(alias_generator=to_camel, populate_by_name=True, frozen=True)


class ObjectMetadata(ApiObject):
    """What all objects have."""

    name: str
    uid: str = ""
    labels: dict[str, str] = {}
    resource_version: str = ""
    creation_timestamp: datetime.datetime | None = None
    deletion_timestamp: datetime.datetime | None = None


class Condition(ApiObject):
    """A condition of an object."""

    type: str
    status: str
    reason: str | None = None
    message: str | None = None
    last_transition_time: datetime.datetime | None = None


class WaitingContainer(ApiObject):
    """Why a container does not run yet."""

    reason: str = ""
    message: str = ""


class RunningContainer(ApiObject):
    """A container that runs."""


class TerminatedContainer(ApiObject):
    """How a container ended. `message` is what it wrote for that purpose, or the words of the container runtime."""

    exit_code: int
    reason: str = ""
    message: str = ""


class ContainerState(ApiObject):
    """One of these."""

    waiting: WaitingContainer | None = None
    running: RunningContainer | None = None
    terminated: TerminatedContainer | None = None


class ContainerStatus(ApiObject):
    """The state of a container."""

    name: str
    state: ContainerState = ContainerState()


class PodSpecification(ApiObject):
    """Where a pod is."""

    node_name: str | None = None


class PodStatus(ApiObject):
    """The state of a pod."""

    phase: str = "Pending"
    reason: str = ""
    message: str = ""
    conditions: list[Condition] = []
    container_statuses: list[ContainerStatus] = []


class Pod(ApiObject):
    """A pod. `is_disrupted`, which the API server does not say: its end was requested before it was seen to end."""

    metadata: ObjectMetadata
    spec: PodSpecification = PodSpecification()
    status: PodStatus = PodStatus()
    is_disrupted: bool = Field(False, exclude=True)

    @property
    def has_ended(self) -> bool:
        """Whether none of its containers runs, or will."""
        return self.status.phase in {"Succeeded", "Failed"}

    @property
    def container(self) -> ContainerState:
        """The state of its only container."""
        return self.status.container_statuses[0].state if self.status.container_statuses else ContainerState()

    def condition(self, name: str) -> Condition | None:
        """Return a condition."""
        return next((condition for condition in self.status.conditions if condition.type == name), None)


class JobStatus(ApiObject):
    """The state of a Job."""

    conditions: list[Condition] = []


class ClusterJob(ApiObject):
    """A Job."""

    metadata: ObjectMetadata
    status: JobStatus = JobStatus()

    @property
    def failure(self) -> str | None:
        """Why it failed, in the words of the cluster; None where it did not."""
        for condition in self.status.conditions:
            if condition.type == "Failed" and condition.status == "True":
                return condition.message or condition.reason or "it failed"
        return None


class PodEvent(BaseModel):
    """A change of a pod, after which a watch can continue from `version`; without a pod, that alone."""

    version: str
    is_deleted: bool = False
    pod: Pod | None = None
