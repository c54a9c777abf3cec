"""Layouts of the mission viewer: the shared ones of a project, and one's own."""

from collections.abc import Sequence

from kleinkram.client._resources import ApiResource, Listing, Ref, checked, pages
from kleinkram.client.missions import Projects
from kleinkram.contract.viewer_layouts import ViewerLayoutCreate, ViewerLayoutRead, ViewerLayoutUpdate


class ViewerLayouts(ApiResource):
    """`client.viewer_layouts`."""

    def list(self, project: Ref, *, limit: int | None = None) -> Listing[ViewerLayoutRead]:
        """Yield the shared layouts of a project and one's own, by name."""
        return pages(self._api, self._path(project), ViewerLayoutRead, [], limit=limit)

    def create(self, project: Ref, name: str, panels: Sequence[str], *, is_shared: bool = False) -> ViewerLayoutRead:
        """Add a layout to a project: one's own, or one that all who read the project see.

        Args:
            project: the project.
            name: the name.
            panels: at most 16, such as `plot:1@/imu,linear_acceleration.x`: the kind, the place of a recording among
                those that have the topic, the topic and its fields.
            is_shared: whether others see it.

        Raises:
            NameTaken: there is one of that name.
            Forbidden: sharing requires WRITE on the project.
        """
        body = checked(ViewerLayoutCreate, "The layout", name=name, panels=[*panels], is_shared=is_shared)
        return self._api.send("POST", self._path(project), ViewerLayoutRead, body)

    def update(
        self, layout: ViewerLayoutRead, *, if_match: str | None = None, **changes: str | bool | Sequence[str]
    ) -> ViewerLayoutRead:
        """Change some fields of `ViewerLayoutUpdate` and return the layout.

        Raises:
            NameTaken: another one has the name.
            EditConflict: the ETag of the layout is not `if_match`.
            Forbidden: this requires WRITE on the project, except for one's own.
        """
        body = checked(ViewerLayoutUpdate, "The layout", **changes)
        return self._api.patch(self._path(layout.project_id, layout), ViewerLayoutRead, body, etag=if_match)

    def delete(self, layout: ViewerLayoutRead) -> None:
        """Delete a layout. Requires WRITE on the project, except for one's own."""
        self._api.delete(self._path(layout.project_id, layout))

    def _path(self, project: Ref, layout: ViewerLayoutRead | None = None) -> str:
        of_project = f"/projects/{Projects(self._api).id_of(project)}/viewer-layouts"
        return of_project if layout is None else f"{of_project}/{layout.id}"
