import pytest
from served import served


@pytest.fixture(scope="module")
def address():
    """The address of a console of the car, on this machine."""
    with served("cruise_control") as (_, found):
        yield found
