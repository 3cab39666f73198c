"""Unsafe commands to the train, of ATO, supervisor and train protection: rows of the hazard table."""

from __future__ import annotations

from msgs_docs.generate.fault_table import BEGIN
from msgs_docs.generate.hazard_table import (
    ENGAGEMENT_TEST,
    FULL_TRACTION,
    SUPERVISOR_TEST,
    HazardRow,
    RemovalPair,
    with_full_traction,
)
from msgs_docs.generate.monitor_removal import (
    ALIVE,
    ASSURANCE,
    ATO_STATE,
    BRAKE_DATA,
    COMMAND_AGE,
    PROTECTION,
    RECEIVER,
    RELEASE_AGE,
    SEPARATION,
    SETTINGS,
    SUPERVISOR,
    TIME_LIMITS,
    TRACK,
    VALIDITY,
)

STACK = "train_ato.control.stack:ControlStack.step"
MODE = "train_ato.loop.ato_mode:AtoMode.update"
BRAKE_MODEL = "train_ato.supervision.plant_brake:plant_train"

TRACTION: tuple[HazardRow, ...] = (
    HazardRow(
        "REQ-01", "H1", "traction command", "provided wrongly",
        "Traction at the speed limit.",
        "Above the intervention speed the supervisor cuts traction off and brakes, whatever the ATO commands.",
        (TRACK, SUPERVISOR),
        ("command frozen with new stamps",),
        pair=RemovalPair((TRACK,), "command frozen with new stamps"),
    ),
    HazardRow(
        "REQ-02", "H6", "traction command", "provided wrongly",
        "A command that is not finite, not possible, or of a second sender.",
        "Such a command is refused and counts as a missing one.",
        (VALIDITY, RECEIVER),
        ("command NaN", "command infinite", "command out of range", "foreign command with the true stamp"),
        pair=RemovalPair((VALIDITY,), "command NaN"),
    ),
    HazardRow(
        "REQ-03", "H5", "traction command", "provided wrongly",
        "Traction while a brake is in effect; it would act at its release.",
        "A brake in effect disengages the ATO, and a disengaged ATO commands no traction.",
        (ATO_STATE, MODE, PROTECTION),
        ("emergency brake by request",),
        (ENGAGEMENT_TEST + "test_the_emergency_brake_cuts_the_traction_at_once",),
        RemovalPair((ATO_STATE,), "emergency brake by request"),
    ),
    HazardRow(
        "REQ-04", "H3", "traction command", "provided wrongly",
        "Force against the running direction at the departure of a train with reversing drives.",
        "After a movement backwards of 2 m the supervisor applies the emergency brake.",
        (SUPERVISOR,),
        tests=(SUPERVISOR_TEST + "test_a_train_that_rolls_back_is_braked_after_two_metres",),
        pair=RemovalPair(
            (SUPERVISOR,),
            sets=("plant.reversing=true", "faults=[{topic: ato/command, begin: 2.5, do: corrupt, value: sign}]"),
        ),
    ),
    HazardRow(
        "REQ-05", "H8", "traction command", "provided wrongly",
        "A command from a missing or wrong disturbance estimate.",
        "Without a valid estimate the law goes on with the disturbance 0.",
        (RECEIVER, STACK),
        ("estimate lost", "estimate infinite", "observer killed"),
    ),
    HazardRow(
        "REQ-06", "H8", "traction command", "too early or late",
        "Old commands act, delayed, repeated or out of order.",
        "The age of the newest command in effect is limited; beyond it the train coasts, then it brakes.",
        (COMMAND_AGE, RECEIVER),
        (
            "command 2 s late", "command 10 s late", "controller slow by 2 s", "delay of the link jumps by 2 s",
            "delay of the link jumps by 10 s", "command repeated", "commands reversed in 3 s",
        ),
        ("test/test_link_threats.py::test_no_message_is_inserted_repeated_or_out_of_sequence",),
        RemovalPair((COMMAND_AGE,), "command 10 s late"),
    ),
    HazardRow(
        "REQ-07", "H8", "traction command", "too long or too short",
        "The last command acts on after the loss of the controller or of the link.",
        "Without a new command traction is off after 0.5 s, and the train brakes to standstill.",
        (COMMAND_AGE, PROTECTION),
        (
            "command lost", "controller killed", "controller stopped", "no command arrives",
            "99.9 % of the commands lost on the link", "99.9 % of the commands lost, heavy train",
            "command lost at 1350 s",
        ),
        (SUPERVISOR_TEST + "test_the_reaction_to_missing_commands_rises_with_their_age",),
        RemovalPair((COMMAND_AGE,), "controller killed"),
    ),
)  # fmt: skip
"""Unsafe traction commands."""

BRAKE: tuple[HazardRow, ...] = (
    HazardRow(
        "REQ-08", "H2", "brake command", "not provided",
        "The electric brake is dead, or the command has the wrong sign.",
        "The supervisor stops the train before the supervised location with the emergency brake alone.",
        (TRACK, SUPERVISOR),
        ("electric brake dead", "electric brake dead from 1200 s", "brake command with the other sign"),
        (SUPERVISOR_TEST + "test_the_train_is_stopped_before_the_end_of_authority",),
        RemovalPair((TRACK,), "electric brake dead"),
    ),
    HazardRow(
        "REQ-09", "H6", "brake command", "not provided",
        "The command of the brake pipe is lost or not possible.",
        "A missing command of the brake pipe counts as a missing command of the ATO.",
        (COMMAND_AGE, VALIDITY),
        ("pipe command lost", "pipe command out of range", "pipe command lost at 1280 s"),
        pair=RemovalPair((COMMAND_AGE,), "pipe command lost"),
    ),
    HazardRow(
        "REQ-10", "H2", "brake command", "provided wrongly",
        "Braking in place of traction.",
        "The train stops ahead of the planned stop; no intervention follows.",
        (SUPERVISOR,),
        ("traction command with the other sign",),
    ),
    HazardRow(
        "REQ-11", "H2", "brake command", "too early or late",
        "Braking has less effect than planned: drives cut out, low adhesion.",
        "The supervised location is kept with the braking ability of the emergency brake.",
        (TRACK, SUPERVISOR),
        ("drives cut out", "adhesion falls to 35 % at the last braking"),
        pair=RemovalPair((TRACK,), "drives cut out"),
    ),
    HazardRow(
        "REQ-12", "H3", "brake command", "too long or too short",
        "A brake command of reversing drives acts on after standstill and drives the train back.",
        "After a movement backwards of 2 m the emergency brake is applied and not released.",
        (SUPERVISOR,),
        tests=(
            SUPERVISOR_TEST + "test_the_brake_of_a_train_that_rolled_back_is_not_released",
            "test/test_plant_emergency.py::test_a_service_stop_of_a_reversing_train_never_drives_it_back",
        ),
        pair=RemovalPair(
            (SUPERVISOR,), sets=("plant.reversing=true", "faults=[{topic: ato/command, begin: 44, do: freeze}]")
        ),
    ),
)  # fmt: skip
"""Unsafe brake commands."""

DEMAND: tuple[HazardRow, ...] = (
    HazardRow(
        "REQ-13", "H1", "brake demand", "not provided",
        "The supervisor is lost, or its brake release is not valid.",
        "Without a recent valid brake release the train applies the emergency brake.",
        (RELEASE_AGE, RECEIVER, VALIDITY),
        (
            "supervisor killed", "supervisor stopped", "supervisor killed, heavy train", "brake release lost",
            "brake release repeated", "brake release NaN", "brake release with a wrong bit",
        ),
        (SUPERVISOR_TEST + "test_only_the_exact_value_releases",
         "test/test_message_faults.py::test_no_flipped_bit_of_a_release_releases_a_brake"),
        RemovalPair(
            (RELEASE_AGE,), sets=(f"faults=[{FULL_TRACTION}, {{do: kill, node: supervisor, at: {BEGIN}}}]",)
        ),
    ),
    HazardRow(
        "REQ-14", "H9", "brake demand", "provided wrongly",
        "A brake demand on a nominal run, or for a refused message.",
        "A nominal run stays outside of all limits; a single refused message has no consequence.",
        (SETTINGS, TRACK, RECEIVER),
        (
            "brake release inserted, stamp 1 s ahead", "foreign brake release with the true stamp",
            "odometry inserted, stamp 1 s ahead",
        ),
        pair=RemovalPair((SETTINGS, ASSURANCE), sets=("faults=[]",)),
    ),
    HazardRow(
        "REQ-15", "H1", "brake demand", "too early or late",
        "The brake release arrives late: it is that of a former speed.",
        "A brake release older than a period of the supervisor and a tick has no effect.",
        (RELEASE_AGE,),
        ("brake release 1 s late", "brake releases reversed in 2 s"),
        pair=RemovalPair(
            (RELEASE_AGE,), sets=with_full_traction("topic: atp/brake_release, do: delay, delay: 20")
        ),
    ),
    HazardRow(
        "REQ-16", "H7", "brake demand", "too long or too short",
        "The supervisor releases a brake above the permitted speed or before standstill.",
        "The service brake ends at the permitted speed, the emergency brake at standstill, a second one never.",
        (SUPERVISOR,),
        tests=(
            SUPERVISOR_TEST + "test_a_service_brake_ends_at_the_permitted_speed_and_an_emergency_brake_at_standstill",
            SUPERVISOR_TEST + "test_the_releases_follow_the_state",
        ),
    ),
    HazardRow(
        "REQ-17", "H1", "brake demand", "too long or too short",
        "The last brake release is repeated with new stamps.",
        "A brake release has an effect if its alive counter has increased.",
        (ALIVE, RELEASE_AGE),
        ("brake release frozen with new stamps",),
        pair=RemovalPair((ALIVE,), sets=with_full_traction("topic: atp/brake_release, do: freeze")),
    ),
)  # fmt: skip
"""Unsafe brake demands of the supervisor."""

EMERGENCY: tuple[HazardRow, ...] = (
    HazardRow(
        "REQ-18", "H5", "emergency brake", "not provided",
        "The train parts; the head brakes against its own traction.",
        "A train separation cuts traction off and applies the emergency brake in both parts.",
        (SEPARATION, PROTECTION),
        ("train separation", "separation downhill"),
        ("test/test_plant_faults.py::test_nothing_releases_a_parted_train",
         "test/test_plant_faults.py::test_traction_is_cut_off_where_the_wave_arrives"),
        RemovalPair((SEPARATION,), "train separation"),
    ),
    HazardRow(
        "REQ-19", "H9", "emergency brake", "provided wrongly",
        "Braking for a short disturbance of the link.",
        "The last command is held for 0.5 s; refused and single lost messages have no consequence.",
        (TIME_LIMITS, COMMAND_AGE, RECEIVER),
        (
            "30 % of the commands lost", "every command twice", "command inserted, stamp 1 s ahead",
            "commands reversed in 0.3 s", "command 0.3 s late", "command with a wrong bit", "second controller",
        ),
        pair=RemovalPair((TIME_LIMITS,), "30 % of the commands lost"),
    ),
    HazardRow(
        "REQ-20", "H2", "emergency brake", "too early or late",
        "The emergency brake is weaker than in the data of the train: brake fade.",
        "The curves use the emergency brake alone with the factor Kdry; the electric brake is not counted.",
        (BRAKE_DATA, BRAKE_MODEL, TRACK),
        ("friction emergency brake faded to 80 %",),
        ("test/test_curves_plant.py::test_deceleration_is_never_above_that_of_the_full_brakes",
         "test/test_curves_plant.py::test_emergency_brake_on_the_intervention_curve_stops_before_the_location"),
        RemovalPair((BRAKE_DATA,), sets=("plant.mismatch={electric_brake_scale: 0, brake_scale: 0.7}",)),
    ),
    HazardRow(
        "REQ-21", "H7", "emergency brake", "too long or too short",
        "The emergency brake ends with the return of a message while the train moves.",
        "The emergency brake of a missing message lasts until standstill.",
        (PROTECTION,),
        tests=(SUPERVISOR_TEST + "test_a_missing_brake_release_applies_the_emergency_brake_until_standstill",),
        pair=RemovalPair(
            (PROTECTION,), sets=(f"faults=[{{topic: ato/command, begin: {BEGIN}, end: 28, do: drop}}]",)
        ),
    ),
)  # fmt: skip
"""Unsafe emergency brakes of the train protection."""
