"""Random histories of rights: the API agrees with the model, and every project has an owner."""

import copy
import datetime
import os
import random
import uuid
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from kleinkram.contract.access import Right
from kleinkram.server.access.builtin_groups import ADMINS_ID, OWNER_ID
from tests.integration.access.rights_model import (
    ADMINS,
    CREATE,
    DELETE,
    LATER,
    NEVER,
    OVER,
    WRITE,
    Grant,
    Membership,
    Rights,
)
from tests.integration.api_server import Answer, Api
from tests.integration.people import join, person, token

_PEOPLE = ("ada", "bob", "cyd")
_GROUPS = ("lab", "crew")
_STEPS = 25
_MANY = int(os.environ.get("KLEINKRAM_SOAK_ROUNDS", "1500"))
_UNTIL = datetime.datetime(2090, 1, 1, tzinfo=datetime.timezone.utc)


class History:
    """A few people, groups, projects and missions of their own on a shared API, beside the model of them."""

    def __init__(self, api: Api, choose: random.Random) -> None:
        self.api, self.choose, self.rights = api, choose, Rights()
        self.tag = f"h{uuid.uuid4().hex[:10]}"
        self.ids: dict[str, str] = {"owner": str(OWNER_ID), ADMINS: str(ADMINS_ID)}
        self.tokens = {"owner": str(api.token)}
        self.log: list[object] = []
        self.rights.active["owner"] = True
        self.rights.members[ADMINS] = {"owner": Membership()}
        for name in _PEOPLE:
            self._person(name)
        for name in _GROUPS:
            self._group(name, editor="ada" if name == "lab" else "bob")
        for name in ("alps", "sea"):
            self._project(name, maker="ada" if name == "alps" else "bob")

    def _person(self, name: str) -> None:
        made = person(self.api, f"{self.tag} {name}", email=f"{self.tag}.{name}@lab.example")
        self.ids[name], self.ids[f"~{name}"], self.tokens[name] = made.id, made.group_id, made.token
        self.rights.active[name] = True
        for own in (f"~{name}", f"@{name}"):
            self.rights.members[own] = {name: Membership()}

    def _group(self, name: str, *, editor: str) -> None:
        made = self._as(editor).post("/groups", {"name": f"{self.tag} {name}"}).ok(201)
        self.ids[name] = made["id"]
        self.rights.members[name] = {editor: Membership(is_editor=True)}

    def _project(self, name: str, *, maker: str) -> None:
        self.ids[name] = self._as(maker).project(name=f"{self.tag} {name}")["id"]
        self.rights.projects.append(name)
        self.rights.grants[name, f"~{maker}"] = Grant(DELETE)
        for number in (1, 2):
            mission = f"{name}-{number}"
            self.ids[mission] = self._as(maker).mission(self.ids[name], name=f"{self.tag} {mission}")["id"]
            self.rights.project_of[mission] = name

    def know_each_other(self) -> None:
        """Put all into a group that gives nothing, so that whom one may grant to is no question."""
        made = self._as("owner").post("/groups", {"name": f"{self.tag} lounge"}).ok(201)
        for name in _PEOPLE:
            join(self.api, self.ids[name], made["id"])

    def step(self) -> None:
        """Do one thing, and see that the API answers as the model says."""
        ways = (self.give, self.give, self.give, self.revoke, self.set_member, self.set_member, self.remove_member)
        others = (self.move, self.delete, self.restore, self.pass_time, self.leave, self.come_back)
        self.choose.choice((*ways, *ways, *others))()

    def _as(self, who: str) -> Api:
        return self.api.as_(self.tokens[who])

    def _somebody(self) -> str:
        return self.choose.choice([*_PEOPLE, *_PEOPLE, "owner"])

    def _place(self) -> str:
        return self.choose.choice([*self.rights.projects, *self.rights.projects, *self.rights.project_of])

    def _writer(self, place: str) -> str:
        """Somebody who may give rights on a place, more often than not; else most of it would be refusals."""
        writers = [name for name in _PEOPLE if self.rights.level(name, place) >= WRITE]
        return self.choose.choice(writers) if writers and self.choose.random() < 0.7 else self._somebody()

    def _path(self, place: str) -> str:
        return f"/{'missions' if place in self.rights.project_of else 'projects'}/{self.ids[place]}"

    def _saw(self, answer: Answer, expected: int, *what: object) -> bool:
        self.log.append((*what, answer.status))
        assert answer.status == expected, f"{self.log}: {answer.body}"
        return expected < 300

    def _try(self, after: Rights, allowed: int, success: int) -> int:
        """The status of something that is otherwise allowed: refused where it leaves a project without an owner."""
        return 409 if allowed == success and after.unowned() else allowed

    def give(self) -> None:
        """Somebody gives a right to somebody, a group, or an address."""
        place = self._place()
        who = self._writer(place)
        group = self.choose.choice([f"~{name}" for name in _PEOPLE] + [f"@{name}" for name in _PEOPLE] + [*_GROUPS])
        grant = Grant(self.choose.choice([1, 2, 3, 3, 4, 4]), self.choose.choice([NEVER, LATER]))
        expected, after = self._may_give(who, place, group, grant), copy.deepcopy(self.rights)
        after.grants[place, group] = grant
        body: dict[str, Any] = {"right": Right.of_level(grant.level).value}
        body |= {} if grant.ends == NEVER else {"expires_at": _UNTIL.isoformat()}
        if group.startswith("~"):
            body["person_id"] = self.ids[group[1:]]
        elif group.startswith("@"):
            body["email"] = f"{self.tag}.{group[1:]}@lab.example"
        else:
            body["group_id"] = self.ids[group]
        answer = self._as(who).post(f"{self._path(place)}/grants", body)
        if self._saw(answer, self._try(after, expected, 201), who, "gives", grant, "to", group, "on", place):
            self.rights = after

    def _may_give(self, who: str, place: str, group: str, grant: Grant) -> int:
        rights, locked = self.rights, self.rights.level(who, place)
        if not rights.active[who]:
            return 401
        if locked < WRITE:
            return 403 if locked else 404
        if group in _GROUPS and not (rights.is_admin(who) or rights.is_live_member(who, group)):
            return 404
        if group.startswith("~") and not rights.active[group[1:]]:
            return 404
        old = rights.grants.get((place, group))
        if old == grant:
            return 201
        too_high = old is not None and old.ends != OVER and old.level > locked
        last = (NEVER,) if grant.ends == NEVER else (NEVER, LATER)
        return 403 if too_high or grant.level > rights.level(who, place, last=last) else 201

    def revoke(self) -> None:
        """Somebody takes a grant away."""
        who, (place, group) = self._somebody(), self.choose.choice(list(self.rights.grants))
        locked, after = self.rights.level(who, place), copy.deepcopy(self.rights)
        grant, grant_id = after.grants.pop((place, group)), self._grant_id(place, group)
        expected = 204 if locked >= WRITE and (grant.ends == OVER or grant.level <= locked) else 403 if locked else 404
        expected = expected if self.rights.active[who] else 401
        answer = self._as(who).delete(f"{self._path(place)}/grants/{grant_id}")
        if self._saw(answer, self._try(after, expected, 204), who, "revokes", grant, "of", group, "on", place):
            self.rights = after

    def _grant_id(self, place: str, group: str) -> str:
        column = "mission_id" if place in self.rights.project_of else "project_id"
        of_group = "g.kind = 'email' AND g.name = %s" if group.startswith("@") else "g.id = %s"
        value = f"{self.tag}.{group[1:]}@lab.example" if group.startswith("@") else self.ids[group]
        actual = self.api.sql(
            f"SELECT a.id::text FROM access_grant a JOIN access_group g ON g.id = a.group_id"
            f" WHERE a.{column} = %s AND {of_group}",
            *(self.ids[place], value),
        )
        return str(actual[0][0])

    def set_member(self) -> None:
        """Somebody puts somebody into a group, or changes until when they are in it."""
        who, group, people = self._somebody(), self.choose.choice(_GROUPS), self.choose.choice(_PEOPLE)
        requested = Membership(self.choose.choice([NEVER, NEVER, LATER]), self.choose.random() < 0.5)
        after = copy.deepcopy(self.rights)
        after.members[group][people] = requested
        expected = self._may_manage(who, group)
        if expected == 200 and people not in self.rights.members[group] and not self.rights.active[people]:
            expected = 404
        if (
            expected == 200
            and requested != self.rights.members[group].get(people)
            and self._is_too_long(who, group, requested)
        ):
            expected = 403
        body: dict[str, Any] = {"is_editor": requested.is_editor}
        body |= {} if requested.ends == NEVER else {"expires_at": _UNTIL.isoformat()}
        answer = self._as(who).call("PUT", f"/groups/{self.ids[group]}/members/{self.ids[people]}", body)
        if self._saw(answer, self._try(after, expected, 200), who, "puts", people, "into", group, requested):
            self.rights = after

    def remove_member(self) -> None:
        """Somebody takes somebody out of a group, or leaves it."""
        who, group, people = self._somebody(), self.choose.choice(_GROUPS), self.choose.choice(_PEOPLE)
        after = copy.deepcopy(self.rights)
        was_in = after.members[group].pop(people, None) is not None
        expected = self._may_manage(who, group)
        expected = 200 if who == people and expected == 403 else expected
        expected = (204 if was_in else 404) if expected == 200 else expected
        answer = self._as(who).delete(f"/groups/{self.ids[group]}/members/{self.ids[people]}")
        if self._saw(answer, self._try(after, expected, 204), who, "takes", people, "out of", group):
            self.rights = after

    def _may_manage(self, who: str, group: str) -> int:
        if not self.rights.active[who]:
            return 401
        if self.rights.is_admin(who):
            return 200
        if not self.rights.is_live_member(who, group):
            return 404
        return 200 if self.rights.members[group][who].is_editor else 403

    def _is_too_long(self, who: str, group: str, expected: Membership) -> bool:
        own = self.rights.members[group].get(who)
        return not self.rights.is_admin(who) and own is not None and (own.ends, expected.ends) == (LATER, NEVER)

    def move(self) -> None:
        """Somebody moves a mission to a project; what was granted on it goes along."""
        who, mission = self._somebody(), self.choose.choice(list(self.rights.project_of))
        target = self.choose.choice([name for name in self.rights.projects if name != self.rights.project_of[mission]])
        may = self.rights.level(who, mission) >= DELETE and self.rights.level(who, target) >= CREATE
        answer = self._as(who).patch(self._path(mission), {"project_id": self.ids[target]})
        self.log.append((who, "moves", mission, "to", target, answer.status))
        assert (answer.status == 200) == may, f"{self.log}: {answer.body}"
        if may:
            self.rights.project_of[mission] = target

    def delete(self) -> None:
        """Somebody moves a project or a mission to the trash."""
        who, place = self._somebody(), self._place()
        locked = self.rights.level(who, place)
        expected = 200 if locked == DELETE else 403 if locked else 404 if self.rights.active[who] else 401
        if self._saw(self._as(who).delete(self._path(place)), expected, who, "deletes", place):
            self.rights.deleted.add(place)

    def restore(self) -> None:
        """An admin has something back."""
        place = self.choose.choice([*self.rights.deleted] or ["alps"])
        resource_type = "mission" if place in self.rights.project_of else "project"
        may = place in self.rights.deleted and self.rights.project_of.get(place) not in self.rights.deleted
        answer = self._as("owner").post(f"/trash/{resource_type}/{self.ids[place]}/restore")
        if self._saw(answer, 204 if may else 404, "owner restores", place):
            self.rights.deleted.remove(place)

    def pass_time(self) -> None:
        """The time of what ends later comes, for one grant or membership."""
        grants = [key for key, grant in self.rights.grants.items() if grant.ends == LATER]
        if grants:
            place, group = self.choose.choice(grants)
            grant_id = self._grant_id(place, group)
            self.api.sql("UPDATE access_grant SET expires_at = now() WHERE id = %s", grant_id)
            self.rights.grants[place, group].ends = OVER
        ending = [
            (group, who) for group in _GROUPS for who, item in self.rights.members[group].items() if item.ends == LATER
        ]
        if ending:
            group, who = self.choose.choice(ending)
            ids = (self.ids[group], self.ids[who])
            self.api.sql("UPDATE membership SET expires_at = now() WHERE group_id = %s AND person_id = %s", *ids)
            self.rights.members[group][who].ends = OVER
        self.log.append(("time passes", grants[:1], ending[:1]))

    def leave(self) -> None:
        """Somebody leaves; what only they owned goes to the admins."""
        people = self.choose.choice(_PEOPLE)
        expected = 200 if self.rights.active[people] else 404
        answer = self._as("owner").post(f"/people/{self.ids[people]}/deactivate")
        if self._saw(answer, expected, people, "leaves"):
            self.rights.active[people] = False
            handed = self.rights.unowned()
            assert answer.body["projects"] == sorted(f"{self.tag} {name}" for name in handed), self.log
            for project in handed:
                self.rights.grants[project, ADMINS] = Grant(DELETE)

    def come_back(self) -> None:
        """Somebody who left is let in again, with a new token."""
        people = self.choose.choice(_PEOPLE)
        self._saw(self._as("owner").post(f"/people/{self.ids[people]}/reactivate"), 200, people, "comes back")
        if not self.rights.active[people]:
            self.tokens[people] = token(self.api, self.ids[people]).secret
            self.rights.active[people] = True

    def see_rights(self, who: str) -> None:
        """See that lists show somebody exactly what the model says, with the right that it says."""
        for path, places in (("/projects", self.rights.projects), ("/missions", list(self.rights.project_of))):
            answer = self._as(who).get(path, {"name": f"{self.tag}*"})
            if not self.rights.active[who]:
                answer.refused(401, "not_authenticated")
                return
            message = {item["id"]: item["right"] for item in answer.ok()["items"]}
            levels = {self.ids[place]: self.rights.level(who, place) for place in places}
            expected = {place: Right.of_level(level).value for place, level in levels.items() if level}
            assert message == expected, (who, self.log)

    def see_owners(self) -> None:
        """See that each project has a lasting owner, by the rows of the database themselves."""
        rows = self.api.sql(
            "SELECT a.project_id::text, a.level, a.expires_at, g.kind, m.expires_at, p.deactivated_at"
            " FROM access_grant a JOIN access_group g ON g.id = a.group_id"
            " JOIN membership m ON m.group_id = g.id JOIN person p ON p.id = m.person_id"
            " WHERE a.project_id = ANY(%s::uuid[])",
            [self.ids[name] for name in self.rights.projects],
        )
        owned = {row[0] for row in rows if row[1:] == (DELETE, None, row[3], None, None) and row[3] != "email"}
        assert owned == {self.ids[name] for name in self.rights.projects}, self.log
        assert self.rights.unowned() == []


def live_through(api: Api, seed: int, *, steps: int) -> None:
    """One history, told by its seed."""
    history = History(api, random.Random(seed))
    history.know_each_other()
    for number in range(steps):
        history.step()
        history.see_owners()
        history.see_rights(_PEOPLE[number % len(_PEOPLE)])
    for who in (*_PEOPLE, "owner"):
        history.see_rights(who)


# What fails is told by its whole history: shrinking a seed would only find another.
_PHASES = [Phase.explicit, Phase.reuse, Phase.generate]
_CHECKS = [HealthCheck.function_scoped_fixture]


@pytest.mark.timeout(400)
@settings(max_examples=5, deadline=None, phases=_PHASES, suppress_health_check=_CHECKS)
@given(seed=st.integers(0, 2**32))
def test_the_highest_unexpired_grant_counts_and_projects_keep_an_owner(api: Api, seed: int) -> None:
    live_through(api, seed, steps=_STEPS)


@pytest.mark.soak
@settings(max_examples=_MANY, deadline=None, phases=_PHASES, suppress_health_check=_CHECKS)
@given(seed=st.integers(0, 2**32))
def test_rights_are_correct_in_many_long_histories(api: Api, seed: int) -> None:
    live_through(api, seed, steps=60)
