"""Trains of the tests of braking curves, with numbers that permit a calculation by hand."""

from train_ato.supervision.settings import FixedValues
from train_ato.supervision.step_function import StepFunction
from train_ato.supervision.train_model import SupervisedTrain, gamma_brake

FIXED = FixedValues()
ONE = StepFunction.constant(1.0)
LEVEL = StepFunction.constant(0.0)


def supervised_train(
    emergency: float | StepFunction = 1.0, service: float | None = 0.7, service_time: float = 6.0, **more: object
) -> SupervisedTrain:
    """Return a train of 200 m and 50 m/s with T_be = 5 s."""
    safe = StepFunction.constant(emergency) if isinstance(emergency, float) else emergency
    curve = None if service is None else StepFunction.constant(service)
    brake = gamma_brake(safe, 5.0, curve, service_time, kdry=ONE, kwet=ONE, adhesion=1.0)
    return SupervisedTrain(200.0, 50.0, brake, **more)  # type: ignore[arg-type]
