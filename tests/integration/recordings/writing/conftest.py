"""Fixtures of the tests of written files."""

import os

import pytest


@pytest.fixture(autouse=True)
def _no_sync(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for the disk, which takes most of the time of a thousand small files."""
    monkeypatch.setattr(os, "fsync", lambda _descriptor: None)
