"""A replay on a slow machine: no view is lost because its answer took too long, only where it ends its regressors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from segmenter.dispatch.dispatcher import Dispatcher, DispatchSettings
from tests.laws.test_laws_histories import calm, memory_folder
from tests.laws.virtual_graph import REGRESSORS, SETTINGS, Graph, Regressor
from tests.laws.virtual_overload import view as made_up_view

SHIPPED = DispatchSettings()
NEVER_S = 1e9


@pytest.mark.parametrize(("credits", "workers"), [(2, 2), (8, 1), (8, 2)])
def test_regressors_slower_than_the_deadline_cost_a_replay_no_view(credits: int, workers: int) -> None:
    """Starved for minutes, two regressors let views pass their deadline five times: 24 of 84 were lost. And once these
    no longer counted, each was weighed again for every time it had been sent, and the line never came to an end.
    """
    expected = calm()
    dispatch = replace(SETTINGS.dispatch, max_attempts=SHIPPED.max_attempts, credits=credits)
    requeued = 0
    with memory_folder() as folder:
        graph = Graph(Path(folder), 7, settings=replace(SETTINGS, dispatch=dispatch))
        for n, name in enumerate(REGRESSORS):
            late_s = 1.2 * dispatch.deadline_s
            graph.regressors[name] = Regressor(weighing_s=late_s, alive_s=0.0 if n < workers else NEVER_S)
        for _ in range(2000):
            graph.turn()
            requeued = max(requeued, *(run.dispatcher.requeued["deadline"] for run in graph.segmenters.values() if run))
            if graph.finished:
                break
        ledger, audit = graph.canonical(), graph.audit()
        graph.close()
    assert requeued > 10 * SHIPPED.max_attempts, "it was not slow enough to say anything"
    assert audit.balanced
    assert ledger == expected


def test_a_view_at_which_regressors_hang_until_they_are_ended_is_lost_with_its_reason() -> None:
    dispatcher = Dispatcher(SHIPPED)
    view = made_up_view(1, 0, captured_ns=0)
    dispatcher.offer(view)
    now_s = 0.0
    for started in range(SHIPPED.max_attempts):
        assert dispatcher.outstanding == 1, f"lost after {started} regressors"
        dispatcher.present({f"r{started}"})
        assert [sent.view_id for _, sent in dispatcher.assign(now_s)] == [view.view_id]
        now_s += SHIPPED.deadline_s
        dispatcher.expire(now_s)
        dispatcher.present(set())  # its watchdog ended it
    assert [loss.reason for loss in dispatcher.take_losses()] == ["max_attempts"]
    assert dispatcher.balance() == {"sent": 1, "weighed": 0, "outstanding": 0, "lost_max_attempts": 1}
