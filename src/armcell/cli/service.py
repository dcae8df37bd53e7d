"""`armcell service`: call a service of a ROS-TCP endpoint or a ROS 1 graph."""

from __future__ import annotations

import typer
import yaml

from armcell.cli.console import console
from armcell.cli.topic import CONNECT, ROS1, connected_bus, fill_message, to_plain_data, yaml_values
from armcell.core import InputError

app = typer.Typer(help="Services of a running endpoint: call.", no_args_is_help=True)


@app.command("call")
def call(
    name: str,
    type_name: str = typer.Argument(..., metavar="TYPE", help="For instance std_srvs/Trigger."),
    request: str = typer.Argument("{}", help="The request's fields as YAML; what is left out is zero."),
    connect: str = CONNECT,
    ros1: bool = ROS1,
    timeout: float = typer.Option(60.0, min=0.1, help="Seconds to wait for the answer."),
) -> None:
    """Call a ROS service and print its response as YAML.

    The protocol has no list of services, so the type is required; `armcell msg list` shows the types.
    """
    from armcell.ros import schema
    from armcell.ros.bus import ServiceError

    request_class, _ = schema().service(type_name)
    message = fill_message(request_class(), yaml_values(request))
    with connected_bus(connect, timeout, ros1, use={name: type_name}) as (bus, _):
        try:
            answer = bus.call(name, message)
        except ServiceError as error:
            raise InputError(str(error)) from None
    console.print(
        yaml.safe_dump(to_plain_data(answer), sort_keys=False), end="", soft_wrap=True, markup=False
    )
