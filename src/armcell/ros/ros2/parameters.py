"""Server of the bus's parameters as parameters of a ROS 2 node, for `ros2 param`.

The bus uses ROS 1's global names; `/a/b` becomes the node's parameter `a.b`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from armcell.core import ArmcellError
from armcell.ros.ros2.context import Context
from armcell.ros.ros2.qos import PARAMETERS
from armcell.ros.ros2.services import RequestId, Server

# rcl_interfaces/ParameterType, with the field of ParameterValue that holds such a value
NOT_SET = 0
FIELDS = {
    1: "bool_value", 2: "integer_value", 3: "double_value", 4: "string_value", 5: "byte_array_value",
    6: "bool_array_value", 7: "integer_array_value", 8: "double_array_value", 9: "string_array_value",
}  # fmt: skip
SCALARS: tuple[tuple[type, int], ...] = ((bool, 1), (int, 2), (float, 3), (str, 4))
USE_SIM_TIME = "use_sim_time"


def kind_of(value: Any) -> int:
    """Return the ParameterType (rcl_interfaces) of a value,
    or NOT_SET if ROS 2 parameters cannot have such a value.
    """
    if isinstance(value, (bytes, bytearray)):
        return 5
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        kinds = {kind_of(item) for item in value}
        if kinds == {2, 3}:
            kinds = {3}
        return {1: 6, 2: 7, 3: 8, 4: 9}.get(kinds.pop(), NOT_SET) if len(kinds) == 1 else NOT_SET
    return next((kind for cls, kind in SCALARS if isinstance(value, cls)), NOT_SET)


class ParameterServices:
    """Server of the six parameter services that every ROS 2 node has.
    They give access to the parameters of the bus.
    """

    def __init__(self, context: Context, node: str):
        self._context, self._parameters = context, context.bus.parameters
        answers: dict[str, tuple[str, Callable[[Any], Any]]] = {
            "list_parameters": ("ListParameters", self._list),
            "get_parameters": ("GetParameters", self._get),
            "get_parameter_types": ("GetParameterTypes", self._types),
            "describe_parameters": ("DescribeParameters", self._describe),
            "set_parameters": ("SetParameters", self._set),
            "set_parameters_atomically": ("SetParametersAtomically", self._set_all),
        }
        self._servers = [
            self._serve(f"{node}/{name}", f"rcl_interfaces/{type_name}", answer)
            for name, (type_name, answer) in answers.items()
        ]

    def close(self) -> None:
        for server in self._servers:
            server.close()

    def _serve(self, name: str, type_name: str, answer: Callable[[Any], Any]) -> Server:
        def on_request(server: Server, request: Any, asked: RequestId) -> None:
            server.reply(asked, self._new(f"{type_name}Response", answer(request)))

        return Server(self._context, name, type_name, on_request, profile=PARAMETERS)

    def _new(self, name: str, *values: Any) -> Any:
        return self._context.codec.new(name, *values)

    # --- names and values ---
    def _names(self) -> list[str]:
        known = self._parameters.names()
        return sorted({name[1:].replace("/", ".") for name in known} | {USE_SIM_TIME})

    def _read(self, name: str) -> Any:
        """Return the value of a bus parameter for a ROS 2 client, or None if the parameter is not set."""
        if name == USE_SIM_TIME:
            return self._context.bus.clock.is_simulated
        try:
            return self._parameters.get("/" + name.replace(".", "/"), None)
        except ArmcellError:  # the name is invalid
            return None

    def _value(self, value: Any) -> Any:
        kind = kind_of(value)
        if kind == NOT_SET:
            return self._new("rcl_interfaces/ParameterValue")
        if isinstance(value, (bytes, bytearray)):
            value = list(np.frombuffer(value, np.int8))
        message = self._context.codec.message("rcl_interfaces/ParameterValue")
        return message(type=kind, **{FIELDS[kind]: value})  # type: ignore[call-arg]

    # --- answers ---
    def _list(self, request: Any) -> Any:
        names = [name for name in self._names() if _below(name, request.prefixes, int(request.depth))]
        prefixes = sorted({name.rpartition(".")[0] for name in names} - {""})
        return self._new("rcl_interfaces/ListParametersResult", names, prefixes)

    def _get(self, request: Any) -> Any:
        return [self._value(self._read(name)) for name in request.names]

    def _types(self, request: Any) -> Any:
        return [kind_of(self._read(name)) for name in request.names]

    def _describe(self, request: Any) -> Any:
        descriptor: Any = self._context.codec.message("rcl_interfaces/ParameterDescriptor")
        return [
            descriptor(name=name, type=kind_of(self._read(name)), read_only=name == USE_SIM_TIME)
            for name in request.names
        ]

    def _set(self, request: Any) -> Any:
        return [self._set_one(p) for p in request.parameters]

    def _set_all(self, request: Any) -> Any:
        refused = [r for r in (self._check(p) for p in request.parameters) if r]
        if refused:
            return self._new("rcl_interfaces/SetParametersResult", False, refused[0])
        for parameter in request.parameters:
            self._set_one(parameter)
        return self._new("rcl_interfaces/SetParametersResult", True, "")

    def _set_one(self, parameter: Any) -> Any:
        reason = self._check(parameter)
        if not reason:
            name, kind = "/" + parameter.name.replace(".", "/"), parameter.value.type
            try:
                if kind == NOT_SET:
                    self._parameters.delete(name)
                else:
                    value = getattr(parameter.value, FIELDS[kind])
                    self._parameters.set(name, value.tolist() if isinstance(value, np.ndarray) else value)
            except ArmcellError as error:
                reason = str(error)
        return self._new("rcl_interfaces/SetParametersResult", not reason, reason)

    def _check(self, parameter: Any) -> str:
        """Return why a ROS 2 client cannot set a parameter, or an empty text if the client can set it."""
        if parameter.name == USE_SIM_TIME:
            return "use_sim_time follows the clock of the cell"
        if parameter.value.type not in (NOT_SET, *FIELDS):
            return f"type {parameter.value.type} does not exist"
        return ""


def _below(name: str, prefixes: list[str], depth: int) -> bool:
    """Return whether a ListParameters request of ROS 2 selects a parameter by one of its prefixes.

    Args:
        depth: largest number of levels below the prefix; 0 means any.
    """
    for prefix in prefixes or [""]:
        rest = name if not prefix else name[len(prefix) + 1 :] if name.startswith(prefix + ".") else None
        if prefix and name == prefix:
            return True
        if rest is not None and (not depth or rest.count(".") < depth):
            return True
    return False
