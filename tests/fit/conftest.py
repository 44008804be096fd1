"""Worker processes that fits of several tests share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from sysid.fit.pool import PooledEngine


@pytest.fixture(scope="session")
def workers() -> Iterator[PooledEngine]:
    with PooledEngine(2) as engine:
        yield engine
