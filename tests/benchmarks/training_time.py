"""How long training on the data takes, by the real command."""

from __future__ import annotations

import time
from collections.abc import Iterator

from tests.benchmarks.plan import Plan, train
from tests.benchmarks.table import Goal, Row


def rows(plan: Plan) -> Iterator[Row]:
    if plan.quick or plan.given:
        return
    began = time.monotonic()
    train(plan)
    yield Row("training, --estimator local", time.monotonic() - began, "s", goal=Goal(120.0, 300.0))
