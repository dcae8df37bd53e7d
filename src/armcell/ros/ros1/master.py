"""Built-in ROS master: registry of topics and services, and parameter server.

Source of the API and its answers: wiki.ros.org/ROS/Master_API, Parameter%20Server%20API; the tests compare
the answers with those of rosmaster.
"""

from __future__ import annotations

import logging
import os
import threading
import uuid
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from armcell.core import ArmcellError
from armcell.core.network_endpoints import Endpoint
from armcell.ros.ros1 import xmlrpc
from armcell.ros.ros1.parameters import ParameterTree, subscriber_update
from armcell.ros.ros1.settings import Ros1Settings
from armcell.ros.ros1.xmlrpc import Answer, Method, RpcServer, call_raw

logger = logging.getLogger(__name__)
TELLERS = 4  # threads that notify nodes of changes
TELL_TIMEOUT = 5.0  # [s]
NAME = "/master"


@dataclass
class _Registrations:
    """Registry of the built-in ROS 1 master.
    It lists the nodes of each topic, service or parameter in the order of their registration.
    """

    nodes: dict[str, list[str]] = field(default_factory=dict)

    def add(self, key: str, node: str) -> None:
        have = self.nodes.setdefault(key, [])
        if node not in have:
            have.append(node)

    def remove(self, key: str, node: str) -> bool:
        have = self.nodes.get(key, [])
        if node not in have:
            return False
        have.remove(node)
        if not have:
            del self.nodes[key]
        return True

    def remove_all(self, node: str) -> None:
        for key in list(self.nodes):
            self.remove(key, node)

    def state(self) -> list[Any]:
        return [[key, list(nodes)] for key, nodes in self.nodes.items()]


class Ros1Master:
    """Built-in ROS master, which listens on the port given by
    `settings.master` from `start` (or `with`) to `close`.
    """

    def __init__(self, settings: Ros1Settings):
        self.settings = settings
        self.uri = f"http://{settings.host}:{settings.master_address[1]}/"
        self._lock = threading.Lock()
        self._apis: dict[str, str] = {}  # node name -> address of its XML-RPC server
        self._publishers, self._subscribers = _Registrations(), _Registrations()
        self._services, self._parameter_subscribers = _Registrations(), _Registrations()
        self._service_uris: dict[str, str] = {}
        self._types: dict[str, str] = {}
        self._parameters = ParameterTree()
        self._parameters.set("/run_id", str(uuid.uuid4()))
        self._tellers = _Tellers()
        self._server = RpcServer(settings.bind, settings.master_address[1], self._methods(), "ros1 master")

    def reserve(self) -> None:
        """Bind the port of the built-in ROS 1 master, without accepting connections yet.

        Raises:
            InputError: the port is taken.
        """
        self._server.reserve()
        self.uri = f"http://{self.settings.host}:{self._server.port}/"

    def start(self) -> None:
        """Start serving the API of the built-in ROS 1 master.

        Raises:
            InputError: the port is taken.
        """
        self._server.start()
        self.uri = f"http://{self.settings.host}:{self._server.port}/"

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Return the address on which the built-in ROS 1 master listens. It is valid after `start`."""
        return (self._server.endpoint("ROS 1 master"),)

    def close(self) -> None:
        self._server.close()
        self._tellers.close()

    def __enter__(self) -> Ros1Master:
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _methods(self) -> dict[str, Method]:
        topic, service, key = xmlrpc.graph_name("topic"), xmlrpc.graph_name("service"), self._key
        kind, api, text = xmlrpc.text("topic_type"), xmlrpc.address("caller_api"), xmlrpc.text("subgraph")
        rosrpc, node = xmlrpc.address("service_api"), xmlrpc.graph_name("node")
        return {
            "registerPublisher": Method(self._register_publisher, (topic, kind, api), []),
            "unregisterPublisher": Method(self._unregister_publisher, (topic, api)),
            "registerSubscriber": Method(self._register_subscriber, (topic, kind, api), []),
            "unregisterSubscriber": Method(self._unregister_subscriber, (topic, api)),
            "registerService": Method(self._register_service, (service, rosrpc, api)),
            "unregisterService": Method(self._unregister_service, (service, rosrpc)),
            "lookupService": Method(self._lookup_service, (service,), ""),
            "lookupNode": Method(self._lookup_node, (node,), ""),
            "getPublishedTopics": Method(self._published_topics, (text,), []),
            "getTopicTypes": Method(self._topic_types, empty=[]),
            "getSystemState": Method(self._system_state, empty=[]),
            "getUri": Method(lambda _: (1, "", self.uri), empty=""),
            "getPid": Method(lambda _: (1, "", os.getpid()), empty=-1),
            "shutdown": Method(lambda *_: (0, "this master ends with armcell", 0), (text,), optional=1),
            "setParam": Method(self._set_param, (key, xmlrpc.anything)),
            "getParam": Method(self._get_param, (key,)),
            "deleteParam": Method(self._delete_param, (key,)),
            "hasParam": Method(self._has_param, (key,), False),
            "searchParam": Method(self._search_param, (xmlrpc.text("key"),), ""),
            "getParamNames": Method(self._param_names, empty=[]),
            "subscribeParam": Method(self._subscribe_param, (api, key), {}),
            "unsubscribeParam": Method(self._unsubscribe_param, (api, key)),
        }

    @staticmethod
    def _key(value: Any, caller: str) -> str:
        """Resolve the name of a parameter in a call to the ROS 1 master to its full name. The parts of the
        name may contain any character.
        """
        if not isinstance(value, str) or not value:
            raise xmlrpc.InvalidArgument("ERROR: parameter [key] must be a non-empty string")
        if value.startswith("~"):
            value = f"{caller}/{value[1:]}"
        elif not value.startswith("/"):
            value = f"{caller.rpartition('/')[0]}/{value}"
        return "/" + "/".join(part for part in value.split("/") if part)

    # --- nodes ---
    def _meet(self, node: str, api: str) -> None:
        """Record the address of a node at the ROS 1 master.
        If an older node has the same name, that node is shut down.
        """
        before = self._apis.get(node)
        if before == api:
            return
        self._apis[node] = api
        if before is not None:
            for registrations in self._all():
                registrations.remove_all(node)
            for service in [s for s in self._service_uris if s not in self._services.nodes]:
                del self._service_uris[service]
            reason = f"[{node}] Reason: new node registered with same name"
            self._tellers.tell(before, "shutdown", reason)
            logger.warning("two nodes are called %s: the older one is asked to end", node)

    def _all(self) -> tuple[_Registrations, ...]:
        return self._publishers, self._subscribers, self._services, self._parameter_subscribers

    def _forget_if_idle(self, node: str) -> None:
        if not any(node in nodes for r in self._all() for nodes in r.nodes.values()):
            self._apis.pop(node, None)

    def _uris(self, registrations: _Registrations, key: str) -> list[str]:
        return [self._apis[node] for node in registrations.nodes.get(key, [])]

    def _tell_subscribers(self, topic: str) -> None:
        publishers = self._uris(self._publishers, topic)
        for uri in self._uris(self._subscribers, topic):
            self._tellers.tell(uri, "publisherUpdate", topic, publishers)

    # --- topics ---
    def _register_publisher(self, node: str, topic: str, kind: str, api: str) -> Answer:
        with self._lock:
            self._meet(node, api)
            self._publishers.add(topic, node)
            if kind != "*" or topic not in self._types:
                self._types[topic] = kind
            self._tell_subscribers(topic)
            return 1, f"Registered [{node}] as publisher of [{topic}]", self._uris(self._subscribers, topic)

    def _unregister_publisher(self, node: str, topic: str, api: str) -> Answer:
        with self._lock:
            return self._unregister(self._publishers, node, topic, api, lambda: self._tell_subscribers(topic))

    def _register_subscriber(self, node: str, topic: str, kind: str, api: str) -> Answer:
        with self._lock:
            self._meet(node, api)
            self._subscribers.add(topic, node)
            if kind != "*":
                self._types.setdefault(topic, kind)
            return 1, f"Subscribed to [{topic}]", self._uris(self._publishers, topic)

    def _unregister_subscriber(self, node: str, topic: str, api: str) -> Answer:
        with self._lock:
            return self._unregister(self._subscribers, node, topic, api)

    def _unregister(
        self, registrations: _Registrations, node: str, key: str, api: str,
        then: Callable[[], None] = lambda: None,
    ) -> Answer:  # fmt: skip
        if self._apis.get(node) is None:
            return 1, f"[{node}] is not a registered node", 0
        if self._apis[node] != api or not registrations.remove(key, node):
            return 1, f"[{node}] is not a known provider of [{key}]", 0
        then()
        self._forget_if_idle(node)
        return 1, f"Unregistered [{node}] as provider of [{key}]", 1

    def _published_topics(self, caller: str, subgraph: str) -> Answer:
        below = f"{subgraph.rstrip('/')}/" if subgraph else ""
        with self._lock:
            found = [[t, self._types[t]] for t in self._publishers.nodes if t.startswith(below)]
        return 1, "current topics", found

    def _topic_types(self, caller: str) -> Answer:
        with self._lock:
            return 1, "current system state", [list(item) for item in self._types.items()]

    def _system_state(self, caller: str) -> Answer:
        with self._lock:
            state = [r.state() for r in (self._publishers, self._subscribers, self._services)]
        return 1, "current system state", state

    # --- services and nodes ---
    def _register_service(self, node: str, service: str, uri: str, api: str) -> Answer:
        with self._lock:
            self._meet(node, api)
            before = self._services.nodes.pop(service, [])  # the newest registration replaces the older one
            self._services.add(service, node)
            self._service_uris[service] = uri
            for other in before:
                self._forget_if_idle(other)
        return 1, f"Registered [{node}] as provider of [{service}]", 1

    def _unregister_service(self, node: str, service: str, uri: str) -> Answer:
        with self._lock:
            if self._service_uris.get(service) != uri or not self._services.remove(service, node):
                return 1, f"[{uri}] is no longer the current service api handle for [{service}]", 0
            del self._service_uris[service]
            self._forget_if_idle(node)
        return 1, f"Unregistered [{node}] as provider of [{service}]", 1

    def _lookup_service(self, caller: str, service: str) -> Answer:
        with self._lock:
            uri = self._service_uris.get(service)
        return (1, f"rosrpc URI: [{uri}]", uri) if uri else (-1, "no provider", "")

    def _lookup_node(self, caller: str, node: str) -> Answer:
        with self._lock:
            api = self._apis.get(node)
        return (1, "node api", api) if api else (-1, f"unknown node [{node}]", "")

    # --- parameters ---
    def _set_param(self, caller: str, key: str, value: Any) -> Answer:
        with self._lock:
            try:
                self._parameters.set(key, value)
            except ValueError as error:
                return -1, f"Error: invalid arguments: {error}", 0
            self._tell_of_parameter(key, value, caller)
        return 1, f"parameter {key} set", 0

    def _get_param(self, caller: str, key: str) -> Answer:
        with self._lock:
            try:
                return 1, f"Parameter [{key}]", _copied(self._parameters.get(key))
            except KeyError:
                return -1, f"Parameter [{key}] is not set", 0

    def _delete_param(self, caller: str, key: str) -> Answer:
        with self._lock:
            try:
                self._parameters.delete(key)
            except KeyError:
                return -1, f"parameter [{key}] is not set", 0
            self._tell_of_parameter(key, {}, None)
        return 1, f"parameter {key} deleted", 0

    def _has_param(self, caller: str, key: str) -> Answer:
        with self._lock:
            return 1, key, key in self._parameters

    def _search_param(self, caller: str, key: str) -> Answer:
        if not key.strip("/") or key.startswith("~"):
            return -1, "Error: invalid key", ""
        with self._lock:
            found = self._parameters.search(caller, key)
        return (1, f"Found [{found}]", found) if found else (
            -1, f"Cannot find parameter [{key}] in an upwards search", "",
        )  # fmt: skip

    def _param_names(self, caller: str) -> Answer:
        with self._lock:
            return 1, "Parameter names", self._parameters.names()

    def _subscribe_param(self, node: str, api: str, key: str) -> Answer:
        with self._lock:
            self._meet(node, api)
            self._parameter_subscribers.add(key, node)
            value = _copied(self._parameters.get(key)) if key in self._parameters else {}
        return 1, f"Subscribed to parameter [{key}]", value

    def _unsubscribe_param(self, node: str, api: str, key: str) -> Answer:
        with self._lock:
            self._parameter_subscribers.remove(key, node)
            self._forget_if_idle(node)
        return 1, f"Unsubscribe to parameter [{key}]", 1

    def _tell_of_parameter(self, key: str, value: Any, by: str | None) -> None:
        for subscribed, nodes in self._parameter_subscribers.nodes.items():
            news = subscriber_update(subscribed, key, value)
            for node in nodes:
                if news is not None and node != by:
                    self._tellers.tell(self._apis[node], "paramUpdate", news[0], _copied(news[1]))


def _copied(value: Any) -> Any:
    """Copy the nested dicts of parameters that the ROS 1 master returns, because the master modifies its
    parameters in place.

    Only copies may leave the master's lock.
    """
    return {k: _copied(v) for k, v in value.items()} if isinstance(value, dict) else value


class _Tellers:
    """Threads that notify ROS 1 nodes of changes at the master.
    Each node receives its notifications in the order of the changes.

    A node that does not answer delays no other node.
    """

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(TELLERS, "ros1 master tell")
        self._lock = threading.Lock()
        self._waiting: dict[str, list[tuple[str, tuple[Any, ...]]]] = {}
        self._closed = False

    def tell(self, uri: str, method: str, *arguments: Any) -> None:
        with self._lock:
            if self._closed:
                return
            if uri in self._waiting:
                self._waiting[uri].append((method, arguments))
                return
            self._waiting[uri] = [(method, arguments)]
            self._threads.submit(self._run, uri)

    def _run(self, uri: str) -> None:
        while True:
            with self._lock:
                todo = self._waiting[uri]
                if not todo or self._closed:
                    del self._waiting[uri]
                    return
                self._waiting[uri] = []
            for method, arguments in _newest(todo):
                try:
                    call_raw(uri, method, NAME, *arguments, timeout=TELL_TIMEOUT)
                except ArmcellError as error:
                    logger.debug("%s of %s: %s", method, uri, error)

    def close(self) -> None:
        with self._lock:
            self._closed = True
        self._threads.shutdown(wait=True, cancel_futures=True)


def _newest(todo: list[tuple[str, tuple[Any, ...]]]) -> list[tuple[str, tuple[Any, ...]]]:
    """Remove outdated notifications of the ROS 1 master, so that only the last one for each topic or
    parameter remains.
    """
    last: dict[tuple[str, Any], tuple[str, tuple[Any, ...]]] = {}
    for method, arguments in todo:
        key = (method, arguments[0])
        last.pop(key, None)
        last[key] = (method, arguments)
    return list(last.values())
