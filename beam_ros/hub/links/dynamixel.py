"""A Dynamixel servo of the X series behind Protocol 2.0: the host writes every position, and asks where the motor is.

The servo is led in its operating mode 4, extended position, with both profiles at 0: a goal is followed as it comes,
over many turns, and where none comes any more the servo stands. A sync write, which nobody answers, carries the goal,
so that the question for velocity and position follows it over the bus at once. The servo's bus watchdog watches only
while the motor is on, and every instruction feeds it: the proof holds the hub where it stands, and asks nothing.
"""

from __future__ import annotations

from beam_ros.hub.errors import HubConnectionError
from beam_ros.hub.faults import fault
from beam_ros.hub.link_parameters import DynamixelParameters
from beam_ros.hub.links import dynamixel_protocol as table
from beam_ros.hub.links.dynamixel_protocol import Register
from beam_ros.hub.links.polled_hub import DriveFaults, PolledDrive, PolledHub, capabilities
from beam_ros.hub.links.query_line import Answer, QueryLine, UnreadableAnswerError
from beam_ros.hub.parameters import AxisParameters

RESTART_S = 0.5
"""A servo that restarts answers again after this time [s]."""

CAPABILITIES = capabilities(
    "dynamixel",
    "the servo keeps none of the rig's limits: this program does",
    "positions are led and measured in whole counts, 4096 in one turn",
)


class Dynamixel(PolledDrive):
    """One servo on the bus.

    Parameters
    ----------
    line : QueryLine
        The way to it.
    settings : DynamixelParameters
        Its number on the bus.
    """

    name = "the servo"
    capabilities = CAPABILITIES
    is_fed_by_questions = True
    restarts_to_clear = True

    def __init__(self, line: QueryLine, settings: DynamixelParameters) -> None:
        self._line = line
        self._id = settings.servo_id
        self._watchdog = 0

    # Questions and orders ------------------------------------------------------------------------------

    def ask(self, question: bytes, name: str, size: int = 0) -> tuple[bytes, Answer]:
        """Send a question; return what was asked for, of a size [bytes], and the answer with its times.

        Raises
        ------
        UnreadableAnswerError
            The servo refuses.
        HubProtocolError
            No answer, or another packet.
        HubConnectionError
            The port vanished.
        """
        answer = self._line.ask(question, name, table.take_status)
        status = table.decode(answer.data)
        if status.servo_id != self._id or status.refusal or len(status.parameters) != size:
            what = status.refusal or f"{len(status.parameters)} bytes"
            raise UnreadableAnswerError(
                f"servo {status.servo_id} answered {name!r} with {what}: expected {size} bytes of servo {self._id}; "
                "check dynamixel.id, and look for another host on the bus"
            )
        return status.parameters, answer

    def read_bytes(self, register: Register) -> tuple[bytes, Answer]:
        """Return a register's bytes, and the answer with its times."""
        return self.ask(table.encode_read(self._id, register), f"read {register.name}", register.size)

    def read(self, register: Register) -> int:
        """Return a register without a sign."""
        return int.from_bytes(self.read_bytes(register)[0], "little")

    def write(self, register: Register, value: int) -> None:
        """Set a register where it differs: what the servo keeps without power wears out."""
        if self.read(register) != value:
            self.ask(table.encode_write(self._id, register, value), f"write {register.name} = {value}")

    def _order(self, register: Register, value: int) -> None:
        """Set a register; nobody answers."""
        self._line.tell(table.encode_sync_write(self._id, register, value))

    def _state(self) -> tuple[bool, int, int]:
        """Return whether the motor is on, the hardware's errors, and the watchdog."""
        data, _ = self.read_bytes(table.CONDITION)
        return data[0] == 1, data[6], data[34]

    # The drive -----------------------------------------------------------------------------------------

    def prepare(self, parameters: AxisParameters, metres_per_turn: float) -> tuple[str, float]:
        """Switch the motor off, set modes and watchdog; return what it is, and its watchdog's time [s]."""
        data, _ = self.ask(table.encode(self._id, table.PING), "ping", 3)
        model, firmware = int.from_bytes(data[:2], "little"), data[2]
        if objection := table.model_objection(model, firmware):
            raise HubConnectionError(objection, fault("wrong_version"))
        # A servo that answers nothing but pings says nothing of itself either.
        self._order(table.STATUS_RETURN_LEVEL, table.ANSWER_ALL)
        self.write(table.TORQUE_ENABLE, 0)
        self._check_limits(parameters, abs(metres_per_turn))
        self.write(table.OPERATING_MODE, table.EXTENDED_POSITION)
        self.write(table.PROFILE_ACCELERATION, 0)
        self.write(table.PROFILE_VELOCITY, 0)
        # Never later than the rig file has it.
        units = int(parameters.watchdog_s / table.WATCHDOG_UNIT_S + 1e-9)
        self._watchdog = min(max(units, 1), table.MOST_WATCHDOG)
        self.forgive_silence()
        count = f"counts of {abs(metres_per_turn) / table.COUNTS:.3g} m"
        what = f"{table.MODELS[model]} with firmware {firmware}, Dynamixel {self._id}, {count}, {self._condition()},"
        return what, self._watchdog * table.WATCHDOG_UNIT_S

    def _check_limits(self, parameters: AxisParameters, per_turn: float) -> None:
        """Refuse a servo that cannot be as fast as the rig file has it, or go as far."""
        fastest = self.read(table.VELOCITY_LIMIT) * table.SPEED_UNIT * per_turn
        farthest = table.MOST_TURNS * per_turn
        for name, wanted, most in (
            ("hub.max_speed", parameters.max_speed, fastest),
            ("hub.travel", parameters.travel, farthest),
        ):
            if wanted > most:
                raise HubConnectionError(
                    f"{name} is {wanted:g}: expected at most {most:.4g}, by the Velocity Limit of servo {self._id} "
                    f"and the {table.MOST_TURNS} turns of its mode; correct it, axis.metres_per_unit or the servo",
                    fault("wrong_axis"),
                )

    def _condition(self) -> str:
        data, _ = self.read_bytes(table.VOLTAGE_AND_TEMPERATURE)
        return f"{int.from_bytes(data[:2], 'little') / 10:.1f} V, {data[2]} degrees C"

    def begin_proof(self) -> bool:
        """Hold the hub where it stands: the watchdog watches with the motor on alone, which no error allows."""
        if self._state()[1]:
            return False
        self.take_motor(self.measure()[0])
        if not self.has_motor():
            raise UnreadableAnswerError(
                f"servo {self._id} has no error and does not take the motor: expected Torque Enable to be 1; look "
                "at it in DYNAMIXEL Wizard 2.0"
            )
        return True

    def is_expired(self) -> bool:
        """Return whether the watchdog has acted."""
        return self._state()[2] == table.EXPIRED

    def forgive_silence(self) -> None:
        """Clear the watchdog, and set it anew: a servo that lost its power in between has forgotten it."""
        self.write(table.BUS_WATCHDOG, 0)
        self.write(table.BUS_WATCHDOG, self._watchdog)

    def measure(self) -> tuple[float, float, Answer]:
        """Return where the motor is [turns], its speed [turns/s], and the answer that says so, with its times."""
        data, answer = self.read_bytes(table.VELOCITY_AND_POSITION)
        speed, counts = (int.from_bytes(data[k : k + 4], "little", signed=True) for k in (0, 4))
        return counts / table.COUNTS, speed * table.SPEED_UNIT, answer

    def lead(self, turns: float, speed: float) -> None:
        """Write where the motor is to be [turns]; of its speed the servo hears nothing in this mode."""
        self._order(table.GOAL_POSITION, round(turns * table.COUNTS))

    def look(self, is_on: bool) -> str:
        """Return what is seen of a servo with an error, or of one that does not follow its goal any more."""
        has_motor, errors, watchdog = self._state()
        is_expired = watchdog == table.EXPIRED
        if errors or (is_on and (is_expired or not has_motor)):
            return f"Torque Enable {int(has_motor)}, Bus Watchdog {-1 if is_expired else watchdog}"
        return ""

    def faults(self) -> DriveFaults:
        """Return the servo's hardware errors, and whether its watchdog has acted."""
        _, errors, watchdog = self._state()
        names, is_expired = table.hardware_errors(errors), watchdog == table.EXPIRED
        text = ", ".join(names + ("Bus Watchdog Error",) * is_expired) or "no error"
        return DriveFaults(names, is_expired, f"{text} ({self._condition()})")

    def clear_faults(self) -> None:
        """Restart the servo, which alone ends a shutdown; it forgets its turns."""
        self.ask(table.encode(self._id, table.REBOOT), "reboot")
        self._line.steady.wait(RESTART_S)
        self._line.drain()

    def take_motor(self, turns: float) -> None:
        """Switch the motor on, to hold where it stands."""
        self.lead(turns, 0.0)
        self._order(table.TORQUE_ENABLE, 1)

    def has_motor(self) -> bool:
        """Return whether the motor is led."""
        return self._state()[0]

    def let_go(self) -> None:
        """Switch the motor off."""
        self._order(table.TORQUE_ENABLE, 0)


class DynamixelHub(PolledHub):
    """A hub on a Dynamixel servo; implements ``Hub``."""

    drive_class = Dynamixel
