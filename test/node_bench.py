"""Node of the graph beside a plain node, in one process."""

from rclpy.node import Node
from rclpy.parameter import Parameter
from waiting import LOOK_S, wait_for

from train_ato.messages.codec import Wire
from train_ato.messages.topics import BY_NAME
from train_ato.ros.graph.assembly import executor_of, make_node
from train_ato.ros.graph.graph_result import GraphOptions
from train_ato.ros.nodes.endpoints import ROLES, FirstFailure, NodeEndpoints, message_class, quality_of_service


class Bench:
    """Node of the graph on an executor, and a plain node in the role of the others."""

    def __init__(self, stack, role, setup, domain, arguments=None, **options):
        self.context, self.executor = stack.enter_context(executor_of(domain, arguments))
        self.watch = FirstFailure()
        self.wire = Wire(setup.layout)
        self.endpoints = NodeEndpoints(role, self.wire, self.context, self.watch, ROLES[:-1], arguments)
        rate = options.get("rate") or 0.0
        graph = GraphOptions(lockstep=not rate, timeout=10.0, rate=rate)
        self.node = make_node(role, setup, self.endpoints, None, graph, recorded=options.get("recorded", False))
        self.other = Node("other", context=self.context, enable_rosout=False, start_parameter_services=False)
        self.executor.add_node(self.endpoints.node)
        self.executor.add_node(self.other)
        self.heard = {}

    def listen(self, *names):
        for name in names:
            self.heard[name] = []
            self.other.create_subscription(
                message_class(BY_NAME[name].type), name, qos_profile=quality_of_service(BY_NAME[name]), raw=True,
                callback=lambda data, name=name: self.heard[name].append(self.wire.decode(name, data)),
            )  # fmt: skip

    def speaker(self, name, node=None):
        topic = BY_NAME[name]
        publisher = (node or self.other).create_publisher(message_class(topic.type), name, quality_of_service(topic))
        self.until(lambda: publisher.get_subscription_count() > 0)
        return publisher

    def until(self, condition):
        """Run callbacks until a condition holds."""
        wait_for(condition, turn=lambda: self.executor.spin_once(timeout_sec=LOOK_S))

    def settle(self, turns=10):
        """Run callbacks until messages in flight have arrived."""
        for _ in range(turns):
            self.executor.spin_once(timeout_sec=0.01)

    def call(self, kind, name, **request):
        client = self.other.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(kind.Request(**request))
        self.until(future.done)
        return future.result()


def set_parameter(node, name, value):
    return node.set_parameters([Parameter(name, value=value)])[0]
