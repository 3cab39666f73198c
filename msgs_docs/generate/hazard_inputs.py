"""Unsafe inputs and modes: odometry, measurement, profile, takeover, engagement; rows of the hazard table."""

from __future__ import annotations

from msgs_docs.generate.fault_table import BEGIN
from msgs_docs.generate.hazard_table import ENGAGEMENT_TEST, SUPERVISOR_TEST, HazardRow, RemovalPair, with_full_traction
from msgs_docs.generate.monitor_removal import (
    ASSURANCE,
    ATO_BRAKE,
    ATO_REQUEST,
    ATO_STATE,
    COMMAND_HOLD,
    ESTIMATOR,
    MEASUREMENT_CHECK,
    ODOMETRY_CHECK,
    RECEIVER,
    SUPERVISOR,
    VALIDITY,
)

MODE = "train_ato.loop.ato_mode:AtoMode.update"

REPORTS: tuple[HazardRow, ...] = (
    HazardRow(
        "REQ-22", "H1", "odometry", "not provided",
        "The supervisor has no speed.",
        "Without valid odometry of the present period the supervisor demands the emergency brake.",
        (RECEIVER, VALIDITY, SUPERVISOR),
        ("odometry lost", "odometry repeated", "odometry NaN"),
        (SUPERVISOR_TEST + "test_odometry_that_is_not_finite_applies_the_emergency_brake",),
        RemovalPair((RECEIVER,), sets=with_full_traction("topic: train/odometry, do: drop")),
    ),
    HazardRow(
        "REQ-23", "H2", "odometry", "provided wrongly",
        "Speed and distance are too small: locked wheels, wrong or foreign values.",
        "The larger value of two odometers of different principle counts; implausible odometry is refused.",
        (ESTIMATOR, ODOMETRY_CHECK, VALIDITY),
        (
            "wheels locked at the end", "wheels slip at the start", "odometry with the other sign",
            "odometry with a wrong bit", "foreign odometry with the true stamp",
        ),
        (
            "test/test_odometry.py::test_the_larger_odometer_counts",
            "test/test_odometry.py::test_one_plausible_odometer_is_enough",
        ),
        RemovalPair((ESTIMATOR,), "wheels locked at the end"),
    ),
    HazardRow(
        "REQ-24", "H1", "odometry", "too early or late",
        "The odometry is that of a former place and speed.",
        "Odometry with an old or a future stamp is refused.",
        (RECEIVER,),
        ("odometry 1 s late", "odometry reversed in 2 s"),
        pair=RemovalPair((RECEIVER,), sets=with_full_traction("topic: train/odometry, do: delay, delay: 15")),
    ),
    HazardRow(
        "REQ-25", "H1", "odometry", "too long or too short",
        "The last odometry is repeated with new stamps.",
        "The distances of the odometry must follow from its speeds.",
        (ODOMETRY_CHECK,),
        ("odometry frozen with new stamps",),
        pair=RemovalPair((ODOMETRY_CHECK,), sets=with_full_traction("topic: train/odometry, do: freeze")),
    ),
    HazardRow(
        "REQ-26", "H8", "measurement", "not provided",
        "The ATO has no measurement.",
        "A command is held for `hold_limit` at most; then the ATO fails and brakes.",
        (RECEIVER, COMMAND_HOLD, MEASUREMENT_CHECK),
        ("measurement lost", "measurement NaN"),
        pair=RemovalPair((RECEIVER, MEASUREMENT_CHECK), "measurement lost"),
    ),
    HazardRow(
        "REQ-27", "H8", "measurement", "provided wrongly",
        "Position or speed of the ATO are wrong.",
        "A measurement that differs from the odometry of the supervisor for 1 s is a failure of the ATO.",
        (MEASUREMENT_CHECK, MODE),
        ("measurement with the other sign", "speed 4 m/s low", "position 50 m off", "noise of 0.3 m/s on the speed"),
        (SUPERVISOR_TEST + "test_an_implausible_measurement_is_found_after_the_confirmation",
         SUPERVISOR_TEST + "test_a_short_difference_is_forgotten"),
        RemovalPair((MEASUREMENT_CHECK,), "measurement with the other sign"),
    ),
    HazardRow(
        "REQ-28", "H8", "measurement", "too early or late",
        "The measurement is late.",
        "A measurement older than the time for which a command is held counts as missing.",
        (RECEIVER, MEASUREMENT_CHECK),
        ("measurement 2 s late",),
        pair=RemovalPair((RECEIVER, MEASUREMENT_CHECK), "measurement 2 s late"),
    ),
    HazardRow(
        "REQ-29", "H8", "measurement", "too long or too short",
        "The measurement is frozen.",
        "A frozen measurement is found by its difference from the odometry, or by its stamp.",
        (MEASUREMENT_CHECK, RECEIVER),
        (
            "measurement repeated", "measurement frozen with new stamps", "speed frozen for 40 s",
            "speed frozen for good", "position and speed frozen", "position and speed frozen, heavy train",
            "frozen from 1250 s",
        ),
        pair=RemovalPair((MEASUREMENT_CHECK,), "position and speed frozen"),
    ),
)  # fmt: skip
"""Unsafe odometry and measurement: feedback on which the commands are based."""

MANAGEMENT: tuple[HazardRow, ...] = (
    HazardRow(
        "REQ-30", "H6", "profile and reference", "not provided",
        "The law has no reference.",
        "Without a valid reference the ATO fails after `hold_limit` and brakes.",
        (RECEIVER, COMMAND_HOLD),
        ("reference lost", "profile killed"),
        pair=RemovalPair((RECEIVER,), "profile killed"),
    ),
    HazardRow(
        "REQ-31", "H8", "profile and reference", "provided wrongly",
        "The reference is not finite.",
        "Such a reference is refused, and a law without a valid output fails the ATO.",
        (VALIDITY, COMMAND_HOLD),
        ("reference NaN",),
        pair=RemovalPair(
            (VALIDITY, COMMAND_HOLD), sets=("faults=[{topic: ato/reference, begin: 30, do: corrupt, value: nan}]",)
        ),
    ),
    HazardRow(
        "REQ-32", "H6", "profile and reference", "too early or late",
        "The reference is late.",
        "A reference older than the time for which a command is held counts as missing.",
        (RECEIVER,),
        ("reference 2 s late",),
        pair=RemovalPair(
            (RECEIVER,), sets=(f"faults=[{{topic: ato/reference, begin: {BEGIN}, do: delay, delay: 20}}]",)
        ),
    ),
    HazardRow(
        "REQ-33", "H6", "profile and reference", "too long or too short",
        "A former reference or profile acts on.",
        "A reference that is not of the profile is refused; an engagement needs a new profile.",
        (RECEIVER, MODE),
        ("reference frozen with new stamps", "state of the ATO lost"),
        (ENGAGEMENT_TEST + "test_the_demo_with_an_emergency_brake_on_its_way_stops_at_its_place",),
        RemovalPair((RECEIVER,), "reference frozen with new stamps"),
    ),
    HazardRow(
        "REQ-34", "H9", "takeover", "not provided",
        "The law drives into the limits of the supervisor.",
        "The braking law takes over before the warning limit, without an intervention.",
        (ASSURANCE,),
        pair=RemovalPair((ASSURANCE,), sets=("supervision.overlap=20",)),
    ),
    HazardRow(
        "REQ-35", "H9", "takeover", "provided wrongly",
        "The braking law takes over at the permitted speed.",
        "A steady speed at the permitted speed is left to the law.",
        (ASSURANCE,),
        tests=(SUPERVISOR_TEST + "test_a_steady_speed_at_the_permitted_speed_is_left_to_the_law",),
    ),
    HazardRow(
        "REQ-36", "H9", "takeover", "too early or late",
        "The braking law takes over so late that the supervisor intervenes.",
        "The speed predicted over the reaction time of the brake decides.",
        (ASSURANCE,),
        tests=(ENGAGEMENT_TEST + "test_the_braking_law_keeps_a_bad_law_below_the_warning_limit",),
    ),
    HazardRow(
        "REQ-37", "H9", "takeover", "too long or too short",
        "The braking law gives back at the limit, or never.",
        "The law drives again at `assurance_margin` below the permitted speed, without a jump of the force.",
        (ASSURANCE,),
        tests=(
            SUPERVISOR_TEST
            + "test_the_braking_law_takes_over_before_the_warning_limit_and_gives_back_below_the_permitted_speed",
        ),
    ),
    HazardRow(
        "REQ-38", "H4", "engagement", "provided wrongly",
        "The ATO drives off by itself after the release of an emergency brake.",
        "A brake in effect ends the engagement; a new one needs a request at standstill.",
        (ATO_STATE, MODE),
        tests=(SUPERVISOR_TEST + "test_the_states_of_the_ato_from_a_brake_to_the_next_engagement",
               SUPERVISOR_TEST + "test_a_failure_lasts_until_a_reset_at_standstill"),
        pair=RemovalPair(
            (ATO_STATE,),
            sets=(
                f"interventions=[{{at: {BEGIN}, do: emergency_brake}}, "
                "{at: 45, do: emergency_brake, applied: false}]",
            ),
        ),
    ),
    HazardRow(
        "REQ-39", "H5", "engagement", "too early or late",
        "An engagement while a brake is in effect.",
        "A request to engage is accepted in the state ready only.",
        (ATO_REQUEST, ATO_STATE),
        tests=(ENGAGEMENT_TEST + "test_an_engagement_is_refused_while_a_brake_is_in_effect",),
        pair=RemovalPair(
            (ATO_REQUEST, ATO_STATE),
            sets=(f"interventions=[{{at: {BEGIN}, do: emergency_brake}}]", "ato_requests=[{at: 22, do: engage}]"),
        ),
    ),
    HazardRow(
        "REQ-40", "H8", "engagement", "too long or too short",
        "The ATO remains engaged without the state of the brakes or the limits.",
        "Without valid messages of train protection and supervisor the ATO is disengaged.",
        (ATO_STATE, RECEIVER, MEASUREMENT_CHECK),
        (
            "state of the brakes lost", "state of the brakes with a wrong bit", "speeds of the supervisor lost",
            "speeds of the supervisor frozen",
        ),
    ),
    HazardRow(
        "REQ-41", "H8", "engagement", "too long or too short",
        "A disengaged ATO coasts on, and no driver takes over.",
        "After the takeover time of 5 s a disengaged ATO brakes to standstill.",
        (ATO_BRAKE,),
        tests=(SUPERVISOR_TEST + "test_a_disengaged_ato_coasts_for_the_takeover_time_and_a_failed_one_brakes_at_once",),
        pair=RemovalPair((ATO_BRAKE,), sets=(f"ato_requests=[{{at: {BEGIN}, do: disengage}}]",)),
    ),
)  # fmt: skip
"""Unsafe profiles, takeovers and engagements."""
