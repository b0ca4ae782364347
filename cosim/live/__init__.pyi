"""The public names of `bayesftc.cosim.live`, and where they stand; loaded on first use."""

from .bridge import Bridge as Bridge, Reconnecting as Reconnecting
from .inbox import Inbox as Inbox, Limits as Limits
from .kinds import BRIDGES as BRIDGES
from .udp import UDP as UDP
