"""Experiments with a known answer, at small size; `globule bench physics` shows the figures."""

from __future__ import annotations

import pytest
from globule.bench import physics_fluid as physics


@pytest.mark.parametrize(
    "experiment",
    [
        physics.free_fall,
        physics.momentum,
        physics.hydrostatic,
        physics.dam_break,
        physics.poiseuille,
        physics.taylor_green,
        physics.emitter,
        physics.oscillation,
    ],
)
def test_truth(experiment):
    for row in experiment():
        assert row.ok, row


def test_implicit_viscosity_flows_as_it_should():
    for row in physics.poiseuille(implicit=True):
        assert row.ok, row
