"""The documents that the attacks mutate: every fault and every learner occurs in them."""

import pytest
from documents import FAULTS, LEARNERS

from bayesftc import controllers, cosim


@pytest.mark.parametrize(
    ("texts", "classes", "name"),
    [(FAULTS, cosim.FAULTS, "FAULTS"), (LEARNERS, controllers.LEARNERS, "LEARNERS")],
    ids=["faults", "learners"],
)
def test_every_kind_occurs(texts, classes, name):
    for cls in classes:
        assert any(f'kind = "{cls.__name__}"' in text for text in texts), (
            f"add {cls.__name__} to {name} of tests/attack/documents.py"
        )
