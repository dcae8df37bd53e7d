"""XML-RPC as ROS 1 uses it: each call starts with the caller's name.

Each answer is [code, text, value]. Code 1 means success, 0 failure, -1 an error of the caller
(wiki.ros.org/ROS/Slave_API). Any host on the network can send XML, so the parser accepts no document types
(entities) and no compression, and limits the size of a body.
"""

from __future__ import annotations

import contextlib
import http.client
import logging
import socket
import xmlrpc.client
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler
from typing import Any

from armcell.core import ArmcellError, InputError
from armcell.core.network_endpoints import Endpoint
from armcell.ros.names import resolve
from armcell.ros.ros1.settings import host_and_port
from armcell.ros.ros1.sockets import Listener

logger = logging.getLogger(__name__)
MAX_BODY = 16 << 20  # [bytes] large enough for robot descriptions, which are parameters
MAX_CALLS = 10_000  # in one system.multicall
IDLE = 60.0  # [s] that a connection may stay open between two calls
SUCCESS, FAILURE, ERROR = 1, 0, -1

Answer = tuple[int, str, Any]


class RpcError(ArmcellError):
    """Error of a ROS 1 XML-RPC call: there is no answer, or the answer reports a failure.

    Attributes:
        code: the answered status code; None if no answer arrived.
    """

    def __init__(self, text: str, code: int | None = None):
        super().__init__(text)
        self.code = code


class InvalidArgument(Exception):
    """Exception for an invalid argument of a ROS 1 XML-RPC call. Its text is sent as the answer."""


# --- calling ---
def call_method(uri: str, method: str, *arguments: Any, timeout: float = 5.0) -> Any:
    """Call a ROS 1 XML-RPC method and return the value of its answer.

    Raises:
        RpcError: the server does not answer, or the answer reports a failure.
        InputError: the address is invalid, or XML-RPC cannot carry an argument.
    """
    answer = call_raw(uri, method, *arguments, timeout=timeout)
    if not (isinstance(answer, list) and len(answer) == 3 and isinstance(answer[0], int)):
        raise RpcError(f"{method} at {uri} answered {str(answer)[:100]!r}, not [code, text, value]")
    if answer[0] != SUCCESS:
        raise RpcError(str(answer[1])[:500], answer[0])
    return answer[2]


def call_raw(uri: str, method: str, *arguments: Any, timeout: float = 5.0) -> Any:
    """Call a ROS 1 XML-RPC method and return its raw answer.

    Raises:
        RpcError: the server does not answer, or the answer is not valid XML-RPC.
        InputError: the address is invalid, or XML-RPC cannot carry an argument.
    """
    host, port = host_and_port(uri)
    try:
        body = xmlrpc.client.dumps(arguments, method).encode()
    except (TypeError, OverflowError) as error:
        raise InputError(f"{method}: XML-RPC cannot carry {error}") from None
    connection = http.client.HTTPConnection(host, port, timeout=timeout)
    try:
        headers = {"Content-Type": "text/xml", "User-Agent": "armcell", "Connection": "close"}
        connection.request("POST", "/RPC2", body, headers)
        reply = connection.getresponse()
        data = reply.read(MAX_BODY + 1)
        if reply.status != 200:
            raise RpcError(f"{uri} answered {reply.status} {reply.reason}")
        if len(data) > MAX_BODY:
            raise RpcError(f"{uri} answered more than {MAX_BODY} bytes")
        values, _ = parse_document(data)
        return values[0] if values else None
    except xmlrpc.client.Fault as fault:
        raise RpcError(f"{method} at {uri}: {fault.faultString[:300]}", FAILURE) from None
    except OSError as error:
        raise RpcError(f"no answer from {uri} ({error.strerror or error})") from None
    except http.client.HTTPException as error:
        raise RpcError(f"{uri} does not speak HTTP: {error!r}") from None
    except ValueError as error:
        raise RpcError(f"{uri} answered no XML-RPC: {error}") from None
    finally:
        connection.close()


def parse_document(data: bytes) -> tuple[tuple[Any, ...], str | None]:
    """Parse an XML-RPC document of ROS 1 and return its values.
    For a call, return the name of the method as well.

    Raises:
        ValueError: the data is not valid XML-RPC.
        xmlrpc.client.Fault: the document is a fault.
    """
    target = xmlrpc.client.Unmarshaller(use_builtin_types=True)
    parser = xmlrpc.client.ExpatParser(target)
    parser._parser.StartDoctypeDeclHandler = _no_document_type  # type: ignore[attr-defined]
    try:
        parser.feed(data)
        parser.close()
        return target.close(), target.getmethodname()
    except (xmlrpc.client.Fault, ValueError):
        raise
    except Exception as error:  # the parser raises many types of exceptions
        raise ValueError(f"{type(error).__name__}: {error}") from None


def _no_document_type(*_: Any) -> None:
    raise ValueError("a document type is not accepted")


# --- answering ---
Check = Callable[[Any, str], Any]
"""Validates and converts an argument: called with its value and the caller's name, returns the new value.

Raises:
    Rejected: the value is invalid.
"""


def anything(value: Any, caller: str) -> Any:
    return value


def text(name: str) -> Check:
    def check(value: Any, caller: str) -> str:
        if not isinstance(value, str):
            raise InvalidArgument(f"ERROR: parameter [{name}] must be a string")
        return value

    return check


def graph_name(name: str) -> Check:
    """Create a check that an XML-RPC argument is a ROS graph name.
    The check resolves the name in the namespace of the caller.

    The argument names a topic, service or parameter.
    """

    def check(value: Any, caller: str) -> str:
        if not isinstance(value, str) or not value:
            raise InvalidArgument(f"ERROR: parameter [{name}] must be a non-empty string")
        try:
            if value.startswith("~"):
                return resolve(value[1:], caller)
            return resolve(value, caller.rpartition("/")[0] or "/")
        except InputError:
            raise InvalidArgument(f"ERROR: parameter [{name}] contains illegal chars") from None

    return check


def address(name: str) -> Check:
    def check(value: Any, caller: str) -> str:
        if not isinstance(value, str) or not value.startswith(("http://", "rosrpc://")):
            raise InvalidArgument(f"ERROR: parameter [{name}] is not an XMLRPC URI")
        return value

    return check


def list_of(name: str, each: Check) -> Check:
    def check(value: Any, caller: str) -> list[Any]:
        if not isinstance(value, list):
            raise InvalidArgument(f"ERROR: parameter [{name}] must be a list")
        return [each(item, caller) for item in value]

    return check


@dataclass(frozen=True)
class Method:
    """Method of a ROS 1 XML-RPC API, including the checks of its arguments.

    Args:
        run: called with the caller's name and the validated arguments.
        checks: one check for each argument after the caller's name.
        empty: the value in an answer that reports an error.
        optional: number of trailing arguments that the caller may omit.
    """

    run: Callable[..., Answer]
    checks: tuple[Check, ...] = ()
    empty: Any = 0
    optional: int = 0

    def __call__(self, *given: Any) -> Answer:
        most = 1 + len(self.checks)
        if not given:
            return ERROR, "missing required caller_id parameter", self.empty
        if not most - self.optional <= len(given) <= most:
            return ERROR, "Error: bad call arity", self.empty
        caller, *arguments = given
        if not isinstance(caller, str):
            return ERROR, "caller_id must be a string", self.empty
        try:
            ready = [check(value, caller) for check, value in zip(self.checks, arguments)]
            return self.run(caller, *ready)
        except InvalidArgument as error:
            return ERROR, str(error), self.empty
        except ArmcellError as error:
            return ERROR, f"Error: {error}", self.empty
        except Exception as error:
            logger.exception("an XML-RPC call failed")
            return FAILURE, f"Internal failure: {error}", self.empty


class RpcServer:
    """XML-RPC server for the methods of a ROS 1 API, active from `start` to `close`."""

    def __init__(self, host: str, port: int, methods: Mapping[str, Method], name: str):
        self._methods = methods
        self._listener = Listener(host, port, self._handle, name)
        self.mistakes = 0  # requests that were not valid XML-RPC calls

    @property
    def port(self) -> int:
        return self._listener.address[1]

    def reserve(self) -> None:
        """Bind the port of the ROS 1 XML-RPC server, without accepting connections yet.

        Raises:
            InputError: the address cannot be listened on.
        """
        self._listener.reserve()

    def start(self) -> None:
        """Start serving XML-RPC calls from ROS 1 programs.

        Raises:
            InputError: the address cannot be listened on.
        """
        self._listener.start()

    def endpoint(self, service: str) -> Endpoint:
        """Return the address on which the ROS 1 XML-RPC server listens. It is valid after `start`."""
        return self._listener.endpoint(service)

    def close(self) -> None:
        self._listener.close()

    def _handle(self, sock: socket.socket, peer: str) -> bool:
        with contextlib.suppress(OSError, ValueError):
            _Connection(sock, (peer, 0), self)  # type: ignore[arg-type]  # serves until the connection ends
        return False

    def answer(self, body: bytes) -> bytes:
        """Return the answer of the ROS 1 XML-RPC server to the body of an HTTP request."""
        try:
            arguments, method = parse_document(body)
            if method is None:
                raise ValueError("no method name")
            values: Any = (self._call(method, arguments),)
        except xmlrpc.client.Fault as fault:
            values = fault
        except ValueError as error:
            self.mistakes += 1
            if self.mistakes == 1:
                logger.warning("XML-RPC: not a call: %s", str(error)[:200])
            values = xmlrpc.client.Fault(1, f"not a call: {str(error)[:200]}")
        try:
            return xmlrpc.client.dumps(values, methodresponse=True).encode()
        except (TypeError, OverflowError) as error:
            return xmlrpc.client.dumps(xmlrpc.client.Fault(1, str(error))).encode()

    def _call(self, method: str, arguments: Sequence[Any]) -> Any:
        if method == "system.multicall":
            return [self._one_of_many(one) for one in _calls(arguments)]
        if method == "system.listMethods":
            return sorted([*self._methods, "system.listMethods", "system.multicall"])
        if method not in self._methods:
            raise xmlrpc.client.Fault(1, f'method "{method[:80]}" is not supported')
        return list(self._methods[method](*arguments))

    def _one_of_many(self, one: Any) -> Any:
        try:
            name, arguments = one["methodName"], one["params"]
            if name == "system.multicall" or not isinstance(arguments, list):
                raise TypeError
            return [self._call(name, arguments)]
        except (TypeError, KeyError):
            return {"faultCode": 1, "faultString": "not a call"}
        except xmlrpc.client.Fault as fault:
            return {"faultCode": fault.faultCode, "faultString": fault.faultString}


def _calls(arguments: Sequence[Any]) -> list[Any]:
    if len(arguments) != 1 or not isinstance(arguments[0], list) or len(arguments[0]) > MAX_CALLS:
        raise xmlrpc.client.Fault(1, "system.multicall takes one list of calls")
    return arguments[0]


class _Connection(BaseHTTPRequestHandler):
    """HTTP/1.1 connection to the ROS 1 XML-RPC server, which supports only POST."""

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "armcell", ""
    timeout = IDLE
    disable_nagle_algorithm = True
    wbufsize = -1  # buffered, so that header and body leave in one write
    server: Any

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not length.isdigit():
            return self._refuse(411)
        if int(length) > MAX_BODY:
            return self._refuse(413)
        if self.headers.get("Content-Encoding", "identity") != "identity":
            return self._refuse(415)
        body = self.rfile.read(int(length))
        if len(body) < int(length):
            self.close_connection = True
            return
        answer = self.server.answer(body)
        self.send_response(200)
        self.send_header("Content-Type", "text/xml")
        self.send_header("Content-Length", str(len(answer)))
        self.end_headers()
        self.wfile.write(answer)

    def _refuse(self, status: int) -> None:
        self.close_connection = True
        self.send_error(status)

    def log_message(self, format: str, *arguments: Any) -> None:
        logger.debug("XML-RPC: " + format, *arguments)
