"""Faults of a run with the expected reaction: data of ``msgs_docs/faults.md`` and of ``test/test_fault_table.py``."""

from __future__ import annotations

from dataclasses import dataclass

BASES: dict[str, tuple[str, ...]] = {
    "metro": (
        "xuzhou_metro",
        "supervision.enabled=true",
        "duration=75",
        "profile.phases=[{cruise_for: 2}, {accelerate_to_kmh: 50}, {cruise_until: 40}, {brake_to: 0}]",
    ),
    "demo": ("demo", "duration=300"),
    "daqin": ("daqin_heavy_haul", "duration=2000"),
}
"""Scenario and assignments of the runs by name."""
BEGIN = 20
"""Time of the faults of messages and nodes [s]; the metro train accelerates at 43 km/h."""

COAST, SERVICE = "plant: coast: no command", "plant: service brake: no command"
EMERGENCY, NO_RELEASE = "plant: emergency brake: no command", "plant: emergency brake: no brake release"
SUPERVISOR, ODOMETRY = "supervisor: emergency brake", "supervisor: emergency brake: no valid odometry"
FAILURE, MEASURED = "controller: failure", "controller: failure: measured"
SEPARATION = "plant: emergency brake: train separation"
NO_REFERENCE = "controller: failure: no valid reference"
NOTHING = "plant: finished"
"""Reaction of a run in which nothing is detected."""


@dataclass(frozen=True)
class FaultRow:
    """One fault and its expected reaction.

    Attributes
    ----------
    name
        Fault in words; the key of the row.
    kind
        Threat of EN 50159, or part with the fault.
    sets
        Assignments to the scenario.
    reaction
        Pattern of an event of the run: ``node: message: reason``.
    arrives
        True if the train reaches the planned stop; otherwise it is at standstill elsewhere.
    base
        Key of :data:`BASES`.
    """

    name: str
    kind: str
    sets: tuple[str, ...]
    reaction: str
    arrives: bool = False
    base: str = "metro"

    @property
    def slow(self) -> bool:
        """True for a run of more than a few seconds."""
        return self.base == "daqin"


def _messages(topic: str, *rows: tuple[str, str, str, str] | tuple[str, str, str, str, bool]) -> list[FaultRow]:
    """Return rows of faults of one topic: name, kind, fault, reaction, and True for a train that arrives."""
    return [
        FaultRow(name, kind, (f"faults=[{{topic: {topic}, begin: {BEGIN}, {fault}}}]",), reaction, bool(arrives))
        for name, kind, fault, reaction, *arrives in rows
    ]


def _nodes(*rows: tuple[str, str, str] | tuple[str, str, str, bool]) -> list[FaultRow]:
    """Return rows of faults of nodes: name, fault, reaction, and True for a train that arrives."""
    return [
        FaultRow(name, "node", (f"faults=[{{at: {BEGIN}, {fault}}}]",), reaction, bool(arrives))
        for name, fault, reaction, *arrives in rows
    ]


def _plant(kind: str, *rows: tuple[str, str, str] | tuple[str, str, str, bool], base: str = "metro") -> list[FaultRow]:
    """Return rows of other faults: name, assignment, reaction, and True for a train that arrives."""
    return [FaultRow(name, kind, (text,), reaction, bool(more), base) for name, text, reaction, *more in rows]


ROWS: tuple[FaultRow, ...] = (
    *_messages(
        "ato/command",
        ("command repeated", "repetition", "do: repeat", COAST),
        ("every command twice", "repetition", "do: repeat, message: each", "plant: refused .*: repeated", True),
        ("command lost", "deletion", "do: drop", EMERGENCY),
        ("30 % of the commands lost", "deletion", "do: drop, probability: 0.3", "plant: faults", True),
        ("command inserted, stamp 1 s ahead", "insertion", "do: insert, ahead: 1", "plant: refused .*: stamp", True),
        ("commands reversed in 0.3 s", "re-sequencing", "do: reorder, block: 0.3", "plant: refused .*: repeated", True),
        ("commands reversed in 3 s", "re-sequencing", "do: reorder, block: 3", COAST),
        ("command NaN", "corruption", "do: corrupt, value: nan", COAST),
        ("command infinite", "corruption", "do: corrupt, value: inf", COAST),
        ("command out of range", "corruption", "do: corrupt, value: range", COAST),
        ("traction command with the other sign", "corruption", "do: corrupt, value: sign", NOTHING),
        ("command with a wrong bit", "corruption", "do: corrupt, value: bit", "plant: faults", True),
        ("command 0.3 s late", "delay", "do: delay, delay: 0.3", "plant: faults", True),
        ("command 2 s late", "delay", "do: delay, delay: 2", SERVICE),
        ("command 10 s late", "delay", "do: delay, delay: 10", EMERGENCY),
        ("foreign command with the true stamp", "masquerade", "do: insert", COAST),
        ("command frozen with new stamps", "masquerade", "do: freeze", "supervisor: service brake"),
    ),
    *_messages(
        "atp/brake_release",
        ("brake release repeated", "repetition", "do: repeat", NO_RELEASE),
        ("brake release lost", "deletion", "do: drop", NO_RELEASE),
        ("brake release inserted, stamp 1 s ahead", "insertion", "do: insert, ahead: 1", "plant: refused", True),
        ("brake releases reversed in 2 s", "re-sequencing", "do: reorder, block: 2", NO_RELEASE),
        ("brake release NaN", "corruption", "do: corrupt, value: nan", NO_RELEASE),
        ("brake release with a wrong bit", "corruption", "do: corrupt, value: bit", NO_RELEASE),
        ("brake release 1 s late", "delay", "do: delay, delay: 1", NO_RELEASE),
        ("brake release frozen with new stamps", "masquerade", "do: freeze", NO_RELEASE),
        ("foreign brake release with the true stamp", "masquerade", "do: insert", "plant: refused .*: alive", True),
    ),
    *_messages(
        "train/odometry",
        ("odometry repeated", "repetition", "do: repeat", ODOMETRY),
        ("odometry lost", "deletion", "do: drop", ODOMETRY),
        ("odometry inserted, stamp 1 s ahead", "insertion", "do: insert, ahead: 1", "supervisor: refused", True),
        ("odometry reversed in 2 s", "re-sequencing", "do: reorder, block: 2", ODOMETRY),
        ("odometry NaN", "corruption", "do: corrupt, value: nan", ODOMETRY),
        ("odometry with the other sign", "corruption", "do: corrupt, value: sign", ODOMETRY),
        ("odometry with a wrong bit", "corruption", "do: corrupt, value: bit", ODOMETRY),
        ("odometry 1 s late", "delay", "do: delay, delay: 1", ODOMETRY),
        ("foreign odometry with the true stamp", "masquerade", "do: insert", ODOMETRY),
        ("odometry frozen with new stamps", "masquerade", "do: freeze", ODOMETRY),
    ),
    *_messages(
        "train/measurement",
        ("measurement repeated", "repetition", "do: repeat", FAILURE),
        ("measurement lost", "deletion", "do: drop", "controller: failure: no valid measurement"),
        ("measurement NaN", "corruption", "do: corrupt, value: nan", "controller: failure: no valid measurement"),
        ("measurement with the other sign", "corruption", "do: corrupt, value: sign", MEASURED),
        ("measurement 2 s late", "delay", "do: delay, delay: 2", FAILURE),
        ("measurement frozen with new stamps", "masquerade", "do: freeze", MEASURED),
    ),
    *_messages(
        "ato/reference",
        ("reference lost", "deletion", "do: drop", NO_REFERENCE),
        ("reference NaN", "corruption", "do: corrupt, value: nan", NO_REFERENCE),
        ("reference 2 s late", "delay", "do: delay, delay: 2", NO_REFERENCE),
        ("reference frozen with new stamps", "masquerade", "do: freeze", NO_REFERENCE),
    ),
    *_messages(
        "ato/estimate",
        ("estimate lost", "deletion", "do: drop", "controller: missing ato/estimate", True),
        ("estimate infinite", "corruption", "do: corrupt, value: inf", "controller: refused ato/estimate", True),
    ),
    *_messages(
        "train/protection",
        ("state of the brakes lost", "deletion", "do: drop", "controller: disengaging: no valid train/protection"),
        ("state of the brakes with a wrong bit", "corruption", "do: corrupt, value: bit", "controller: disengaging"),
    ),
    *_messages(
        "atp/speeds",
        ("speeds of the supervisor lost", "deletion", "do: drop", "controller: disengaging: no valid atp/speeds"),
        ("speeds of the supervisor frozen", "masquerade", "do: freeze", MEASURED),
    ),
    *_messages("ato/state", ("state of the ATO lost", "deletion", "do: drop", "profile: missing ato/state", True)),
    *_nodes(
        ("controller killed", "do: kill, node: controller", EMERGENCY),
        ("controller stopped", "do: stop, node: controller", EMERGENCY),
        ("controller slow by 2 s", "do: slow, node: controller, delay: 2", SERVICE),
        ("second controller", "do: duplicate, node: controller", "plant: refused ato/command: repeated", True),
        ("profile killed", "do: kill, node: profile", NO_REFERENCE),
        ("observer killed", "do: kill, node: observer", "controller: missing ato/estimate", True),
        ("supervisor killed", "do: kill, node: supervisor", NO_RELEASE),
        ("supervisor stopped", "do: stop, node: supervisor", NO_RELEASE),
    ),
    *_plant(
        "sensor",
        ("speed frozen for 40 s", "plant.sensors.freeze=[{begin: 10, end: 50, quantity: velocity}]", MEASURED),
        ("speed frozen for good", "plant.sensors.freeze=[{begin: 10, end: 9999, quantity: velocity}]", MEASURED),
        ("position and speed frozen", "plant.sensors.freeze=[{begin: 10, end: 9999}]", MEASURED),
        ("position 50 m off", "plant.sensors.position_bias=50", MEASURED),
        ("speed 4 m/s low", "plant.sensors.velocity_bias=-4", MEASURED),
        ("noise of 0.3 m/s on the speed", "plant.sensors.velocity_noise=0.3", NOTHING, True),
        ("wheels slip at the start", "plant.sensors.wheel_slip=[{begin: 4, end: 14, slip: 1.0}]", NOTHING),
        ("wheels locked at the end", "plant.sensors.wheel_slip=[{begin: 42, end: 9999, slip: -1}]", MEASURED),
    ),
    *_plant(
        "link",
        ("no command arrives", "links.command={delay: 0.3, jump: {at: 0, add: 600}}", EMERGENCY),
        ("99.9 % of the commands lost on the link", "links.command.loss=0.999", EMERGENCY),
        ("delay of the link jumps by 2 s", "links.command.jump={at: 20, add: 2}", SERVICE),
        ("delay of the link jumps by 10 s", "links.command.jump={at: 20, add: 10}", EMERGENCY),
    ),
    *_plant(
        "train",
        ("drives cut out", "plant.jumps=[{at: 20, what: gain, factor: 0}]", "controller: braking law"),
        ("electric brake dead", "plant.mismatch.electric_brake_scale=0", "controller: braking law"),
        ("friction emergency brake faded to 80 %", "plant.mismatch.brake_scale=0.8", NOTHING, True),
        ("emergency brake by request", "interventions=[{at: 20, do: emergency_brake}]", "plant: emergency brake"),
    ),
    FaultRow(
        "adhesion falls to 35 % at the last braking",
        "train",
        (
            "plant.adhesion={kind: constant, coefficient: 0.3}",
            "plant.jumps=[{at: 38, what: adhesion, factor: 0.35}]",
        ),
        NOTHING,
        arrives=True,
    ),
    FaultRow(
        "brake command with the other sign",
        "corruption",
        ("faults=[{do: corrupt, value: sign, topic: ato/command, begin: 41}]",),
        "supervisor: service brake",
    ),
    *_plant(
        "train, 10 684 t",
        ("position and speed frozen, heavy train", "plant.sensors.freeze=[{begin: 100, end: 9999}]", MEASURED),
        ("pipe command lost", "faults=[{do: drop, topic: ato/brake_pipe_command, begin: 100}]", EMERGENCY),
        (
            "pipe command out of range",
            "faults=[{do: corrupt, value: range, topic: ato/brake_pipe_command, begin: 100}]",
            EMERGENCY,
        ),
        ("supervisor killed, heavy train", "faults=[{do: kill, node: supervisor, at: 100}]", NO_RELEASE),
        ("train separation", "plant.jumps=[{at: 150, what: coupler, vehicles: [50]}]", SEPARATION),
        base="demo",
    ),
    *_plant(
        "long descent",
        ("electric brake dead from 1200 s", "plant.jumps=[{at: 1200, what: gain, factor: 0}]", SUPERVISOR),
        ("99.9 % of the commands lost, heavy train", "links.command.loss=0.999", EMERGENCY),
        ("frozen from 1250 s", "plant.sensors.freeze=[{begin: 1250, end: 99999}]", MEASURED),
        ("command lost at 1350 s", "faults=[{do: drop, topic: ato/command, begin: 1350}]", EMERGENCY),
        ("pipe command lost at 1280 s", "faults=[{do: drop, topic: ato/brake_pipe_command, begin: 1280}]", EMERGENCY),
        ("separation downhill", "plant.jumps=[{at: 1350, what: coupler, vehicles: [50]}]", SEPARATION),
        base="daqin",
    ),
)
"""Rows of the table."""
