"""Merging of one hypothesis's values of a sensor into those of another, as text for each list of modes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.mode_kernels import AGE, WEIGHT
from bayesftc.controllers.switching.sensor_kernels import FIRST, HEALTHY, LEAST
from bayesftc.cosim.ops import maximum
from bayesftc.cosim.stepping.source.written import function_from_text

_BEGIN = f"""
remaining, arriving = 1.0 - part, part * scale
healthy, other_healthy = memory[at + {HEALTHY}], scale * memory[other + {HEALTHY}]\
"""

_WEIGHTS = """
incoming{k} = arriving * memory[other + {block} + WEIGHT]
total{k} = maximum(remaining * memory[at + {block} + WEIGHT] + incoming{k}, LEAST)\
"""

_SHARE = """
share{k} = incoming{k} / total{k}\
"""

_END = f"""
memory[at + {HEALTHY}] = maximum(healthy + part * (other_healthy - healthy), LEAST)\
"""

_STORE = """
memory[at + {block} + WEIGHT] = total{k}\
"""

_NUMBER = """
number{here} = memory[at + {here}] + share{k} * (memory[other + {here}] - memory[at + {here}])\
"""

_STORE_NUMBER = """
memory[at + {here}] = number{here}\
"""


@cache
def make_blend_sensor(width: int, spans: tuple[int, ...]) -> Callable[..., None]:
    """Return the step function that merges another hypothesis's values of a sensor, with its ``part`` of the probability.

    The other's probabilities of modes count times ``scale``. The text has a line for each number, because a loop over blocks of
    different lengths takes twice as many instructions. All numbers of a mode are computed before the first is stored. The
    compiler then knows that no store changes a later number, and computes several at once.

    Parameters
    ----------
    width : int
        Width of the block of a mode.
    spans : tuple of int
        For each mode, the part of its block that is merged; modes of span 0 are not.
    """
    used = [(k, FIRST + k * width) for k, span in enumerate(spans) if span > 0]
    text = _BEGIN
    for part in (_WEIGHTS, _SHARE):
        text += "".join(part.format(k=k, block=block) for k, block in used)
    text += _END
    for k, block in used:
        text += "".join(_NUMBER.format(k=k, here=block + a) for a in range(AGE, spans[k]))
        text += _STORE.format(k=k, block=block)
        text += "".join(_STORE_NUMBER.format(here=block + a) for a in range(AGE, spans[k]))
    names = {"maximum": maximum, "WEIGHT": WEIGHT, "LEAST": LEAST, "__name__": __name__}
    lines = text.strip("\n").split("\n")
    return function_from_text("blend_sensor", ("memory", "at", "part", "other", "scale"), lines, names)
