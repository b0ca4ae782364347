"""The public names of `bayesftc.cosim.live`, and where they stand; loaded on first use."""

from .bridge import Bridge as Bridge, Reconnecting as Reconnecting
from .deadlines import Deadlines as Deadlines
from .files import File as File
from .inbox import Inbox as Inbox, Limits as Limits
from .kinds import BRIDGES as BRIDGES
from .mqtt import MQTT as MQTT
from .opcua import OPCUA as OPCUA, OPCUAServer as OPCUAServer
from .recorder import Recorder as Recorder, Recording as Recording, read_recording as read_recording
from .run import LiveSettings as LiveSettings, LiveSummary as LiveSummary, Stop as Stop, run_live as run_live
from .serial_line import Serial as Serial
from .steppers import Received as Received, Stepper as Stepper
from .udp import UDP as UDP
from .wires import Wire as Wire
