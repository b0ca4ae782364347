"""A warning shows the line of the user; tests/cosim/stepping/test_compiler_cache.py has one with imports on the way."""

import warnings

from bayesftc.cosim.base.warnings_shown import warn_user


def test_it_shows_the_line_of_the_caller():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_user("look")
    assert [each.filename for each in caught] == [__file__]
