"""Parameters of the nodes: values at the start, changes and refusals."""

import gc
import warnings
from contextlib import ExitStack

import pytest
from engine_runs import setup_of

pytest.importorskip("rclpy")

from node_bench import Bench, set_parameter
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from waiting import LOOK_S, wait_for

from train_ato.messages.topics import Role
from train_ato.ros.graph.assembly import check_arguments, executor_of, make_node
from train_ato.ros.graph.graph_result import GraphOptions
from train_ato.ros.nodes.endpoints import FirstFailure, NodeEndpoints


@pytest.fixture(scope="module")
def setup():
    return setup_of("demo", "duration=12")


@pytest.fixture
def make(setup, domain):
    with ExitStack() as stack:
        yield lambda role, **options: Bench(stack, role, options.pop("setup", setup), domain, **options)


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("law", "pidd", "did you mean 'pid'"),
        ("law", 3, ""),
        ("pid.kp", float("nan"), ""),
        ("pid.kp", -1e30, ""),
        ("pid.kp", 5, ""),
        ("pid.kq", 5.0, ""),
    ],
)
def test_wrong_parameters_are_refused_and_the_old_law_goes_on(make, name, value, says):
    bench = make(Role.CONTROLLER)
    node = bench.endpoints.node
    before = {p: node.get_parameter(p).value for p in ("law", "pid.kp")}
    try:
        result = set_parameter(node, name, value)
        refused, reason = not result.successful, result.reason
    except Exception as error:
        refused, reason = True, str(error)
    assert refused
    assert says in reason
    assert reason
    assert {p: node.get_parameter(p).value for p in before} == before
    assert bench.node.stage.controller == before["law"]


def test_an_unknown_parameter_is_named(make):
    """Breaks if `ros2 param set` of a wrong name gets the answer of rclpy, which names none."""
    bench = make(Role.CONTROLLER)
    change = Parameter("smc.kss", value=1.0).to_parameter_msg()
    (result,) = bench.call(SetParameters, "controller/set_parameters", parameters=[change]).results
    said = (
        "parameter smc.kss: node controller has none of that name; did you mean 'smc.ks'?; `ros2 param list` names all"
    )
    assert (result.successful, result.reason) == (False, said)


def test_an_accepted_law_is_answered_with_its_advice(make):
    """Breaks if `ros2 param set` of gains that do not fit is answered without the remedy, or the answer lasts."""
    bench = make(Role.CONTROLLER)

    def answered(name, value):
        change = Parameter(name, value=value).to_parameter_msg()
        (result,) = bench.call(SetParameters, "controller/set_parameters", parameters=[change]).results
        assert result.successful
        return result.reason

    remedy = "smc: printed gains, not made for this train; try --set laws.smc.gains=model"
    assert answered("law", "smc") == ""
    assert answered("smc.gains", "printed") == remedy
    assert answered("pid.gains", "model") == ""
    assert answered("law", "smc") == remedy
    (value,) = bench.call(GetParameters, "controller/get_parameters", names=["smc.gains"]).values
    assert value.string_value == "printed"


def test_parameters_set_together_are_checked_together(make):
    """Breaks if each is checked beside the old values of the others: the next step failed the run."""
    node = make(Role.CONTROLLER, arguments=["--ros-args", "-p", "gpc.n:=20", "-p", "gpc.nu:=10"]).endpoints.node

    def answered(**values):
        changes = [Parameter(name.replace("_", "."), value=value) for name, value in values.items()]
        return node.set_parameters_atomically(changes).reason

    assert "nu 15 is longer than n 12" in answered(gpc_nu=15, gpc_n=12, law="gpc")
    assert "nu 15 is longer than n 12" in answered(gpc_nu=15, gpc_n=12)
    assert node.get_parameter("law").value == "pid"
    assert answered(gpc_n=3, gpc_nu=2, law="gpc") == ""


def test_a_controller_that_joins_has_the_planned_law(make):
    """Breaks if its parameters, or the log, name the law of the start after a change during the outage."""
    setup = setup_of("demo", "duration=12", "law_changes=[{at: 2, law: smc, laws: {smc: {ks: 0.02}}}]")
    bench = make(Role.CONTROLLER, setup=setup)
    bench.node.join(3_000_000_000)
    bench.node.join(3_000_000_000)  # its runner does so before and after it connects
    assert [bench.endpoints.node.get_parameter(name).value for name in ("law", "smc.ks")] == ["smc", 0.02]
    assert bench.node.stage.asked == {"smc.ks": 0.02, "controller": "smc"}
    assert bench.node.stage._fit == bench.node.stage._fit_of("smc")


def test_parameters_of_all_laws_have_ranges_and_meanings(make):
    """Fails if a parameter has no range or description: rclpy accepts NaN for a double without a range."""
    bench = make(Role.CONTROLLER)
    names = [name for name in bench.endpoints.node._parameters if "." in name and not name.startswith("qos")]
    assert {name.split(".")[0] for name in names} >= {"pid", "smc"}
    answer = bench.call(DescribeParameters, "controller/describe_parameters", names=names)
    for descriptor in answer.descriptors:
        if descriptor.type == Parameter.Type.DOUBLE.value:
            (limits,) = descriptor.floating_point_range
            assert limits.from_value < limits.to_value
        assert len(descriptor.description) > 5, descriptor.name


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("lawe:=smc", "did you mean 'law'"),
        ("pid.kpp:=1.0", "did you mean 'pid.kp'"),
        ("pid.kp:=-1.0e30", "parameter pid.kp: -1e+30 is refused; give 0 ... 1000000000 1/s or N/(m/s)"),
        ("pid.kp:=.nan", "pid.kp"),
        ("pid.kp:=high", "parameter pid.kp: 'high' is refused; give 0 ... 1000000000 1/s or N/(m/s)"),
        ("pid.per_mass:=1", "parameter pid.per_mass: 1 is refused; give true or false"),
        ("pid.integral:=[speed]", "parameter pid.integral: ['speed'] is refused; give position or speed"),
        ("law:=nosuch", "nosuch"),
    ],
)
def test_wrong_parameters_at_the_start_are_refused(make, given, says):
    """Rclpy ignores a misspelt name; the run would continue with the default."""
    with pytest.raises(ValueError, match=r"law|pid") as caught:
        make(Role.CONTROLLER, arguments=["--ros-args", "-p", given])
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("given", ["pid.kp:=1", "ndo.omega:=5.0", "timeout:=5", "observer:=ndo", "gust.ramp:=1.0"])
def test_a_file_for_all_nodes_and_integers_are_accepted(make, given):
    """Breaks if a node refuses a parameter of another node of a file `/**`, or an integer for a double."""
    bench = make(Role.CONTROLLER, arguments=["--ros-args", "-p", given])
    assert (bench.endpoints.node.get_parameter("pid.kp").value == 1.0) == (given == "pid.kp:=1")


MALFORMED = [
    ["--params-file", "/proc/none.yaml"], ["--params-file", "flat.yaml"], ["--params-file", "broken.yaml"],
    ["--params-file", "indent.yaml"], ["-p", "law"], ["-r", "bad"], ["-r", "__ns:=not/abs"], ["-r", "__node:=1x"],
    ["--log-level", "nonsense"], ["--enclave", "x"], ["--remap"],
    ["--no-such-option"], ["-r", "__node:=my_controller"],
]  # fmt: skip


@pytest.mark.parametrize("given", MALFORMED, ids=" ".join)
def test_malformed_ros_arguments_are_one_line(given, tmp_path, monkeypatch, capfd):
    """Breaks if an error of rcl gives a traceback, or several lines."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flat.yaml").write_text("law: smc\n")
    (tmp_path / "broken.yaml").write_text("a: [\n")
    (tmp_path / "indent.yaml").write_text("controller:\n ros__parameters:\n    law: smc\n   x: 1\n")
    with pytest.raises(ValueError, match="--ros-args") as caught:
        check_arguments(["--ros-args", *given], Role.CONTROLLER)
    assert given[-1] in str(caught.value)
    assert "\n" not in str(caught.value) and "[" not in str(caught.value)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", ["/**/contoller:", "/line:\n contoller:", "line:\n train:\n  contoller:"])
def test_a_misspelt_node_in_a_parameter_file_has_a_note(name, tmp_path, capsys):
    """Breaks if the gains of a file are passed over without a word, or another node has a note too."""
    right, place = "\ncontroller:\n   ros__parameters:\n    law: pid\n", "/".join(name.replace(":", "").split())
    (tmp_path / "a.yaml").write_text(f"{name}\n   ros__parameters:\n    law: smc{right}")
    for role, count in ((Role.PLANT, 0), (Role.CONTROLLER, 1)):
        check_arguments(["--ros-args", "--params-file", str(tmp_path / "a.yaml")], role)
        notes, note = capsys.readouterr().err, f"a.yaml: {place}: no node has this name, and its parameters have no"
        assert notes.count(note) == notes.count("no node has this name") == count


def test_the_recorder_answers_requests_although_it_is_in_no_executor(make):
    """Breaks if it offers services without an answer: `ros2 param list` waits for it."""
    bench = make(Role.CONTROLLER)
    recorder = NodeEndpoints(Role.RECORDER, bench.wire, bench.context, FirstFailure())
    warnings.warn("failed to send response (timeout): client will not receive response", RuntimeWarning, stacklevel=1)
    client = bench.other.create_client(ListParameters, "recorder/list_parameters")
    bench.until(client.service_is_ready)
    answer = client.call_async(ListParameters.Request())
    bench.settle()
    assert not answer.done()
    bench.until(lambda: recorder.answer_requests() or answer.done())
    assert "use_sim_time" in answer.result().result.names


def test_the_recorder_says_a_topic_whose_name_in_the_log_is_another_one(make, setup, tmp_path):
    """Breaks if a remapped topic has the name of the table in the log without a word."""
    bench, said = make(Role.CONTROLLER), []
    arguments = ["--ros-args", "-r", "ato/command:=mine", "-r", "ato/state:=/a/ato/state"]
    recorder = NodeEndpoints(Role.RECORDER, bench.wire, bench.context, FirstFailure(), arguments=arguments)
    recorder.on_note = said.append
    make_node(Role.RECORDER, setup, recorder, tmp_path, GraphOptions()).log.close()
    assert said == ["ato/command is /mine in this graph; the log has it as /ato/command"]


def test_a_node_refused_at_its_start_leaves_the_domain(setup, domain):
    """Breaks if it stays until the next garbage collection, as a second controller of the next run."""
    gc.disable()
    try:
        with ExitStack() as stack, pytest.raises(ValueError, match="no_such") as caught:
            Bench(stack, Role.CONTROLLER, setup, domain, arguments=["--ros-args", "-p", "law:=no_such"])
        with executor_of(domain) as (context, executor):
            watcher = Node("watcher", context=context, enable_rosout=False)
            executor.add_node(watcher)
            wait_for(lambda: "watcher" in watcher.get_node_names(), turn=lambda: executor.spin_once(timeout_sec=LOOK_S))
            for _ in range(10):
                executor.spin_once(timeout_sec=0.1)
            assert watcher.get_node_names() == ["watcher"]
    finally:
        gc.enable()
    assert caught.value.__traceback__ is not None


def test_parameters_at_the_start_are_taken(make):
    """Breaks if a start parameter has no effect."""
    bench = make(Role.CONTROLLER, arguments=["--ros-args", "-p", "law:=smc", "-p", "pid.ki:=0.0"])
    assert bench.node.stage.controller == "smc"
    assert bench.endpoints.node.get_parameter("pid.ki").value == 0.0


@pytest.mark.parametrize(
    ("given", "lockstep", "rate"),
    [(["rate:=5.0"], True, 5.0), (["lockstep:=false"], False, 1.0), (["lockstep:=false", "rate:=4.0"], False, 4.0)],
)
def test_rate_and_lockstep_at_the_start(make, given, lockstep, rate):
    """Breaks if a start parameter is refused, or a run without lockstep gets no rate."""
    bench = make(Role.PLANT, arguments=["--ros-args", *(word for entry in given for word in ("-p", entry))])
    node = bench.endpoints.node
    assert (node.get_parameter("lockstep").value, node.get_parameter("rate").value) == (lockstep, rate)
    assert (bench.node._period is None) == lockstep
    assert not set_parameter(node, "lockstep", not lockstep).successful
    assert set_parameter(node, "rate", 0.0).successful == lockstep


def test_the_observer_can_be_chosen_at_its_start_and_not_later(make):
    bench = make(Role.OBSERVER, arguments=["--ros-args", "-p", "observer:=ndo"])
    assert bench.node.stage.setup.scenario.observer == "ndo"
    assert not set_parameter(bench.endpoints.node, "observer", "none").successful
    with pytest.raises(ValueError, match=r"unknown observer 'nda'.*ndo"):
        make(Role.OBSERVER, arguments=["--ros-args", "-p", "observer:=nda"])


@pytest.mark.parametrize(
    ("changes", "request_name", "success", "says"),
    [
        (("supervision.enabled=false",), "engage", False, "the run has no supervision; set supervision.enabled: true"),
        ((), "engage", False, "engage: the ATO is engaged, not ready"),
        ((), "reset", False, "reset: the ATO is engaged, not failure"),
        ((), "disengage", True, "disengage: from the next step"),
    ],
)
def test_a_request_to_the_ato_is_answered(make, changes, request_name, success, says):
    """Breaks if a service is missing in a run without supervision, or a refusal has no reason."""
    bench = make(Role.CONTROLLER, setup=setup_of("demo", "duration=12", *changes))
    answer = bench.call(Trigger, f"controller/{request_name}")
    assert (answer.success, says in answer.message) == (success, True), answer.message
