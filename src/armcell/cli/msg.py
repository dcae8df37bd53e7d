"""`armcell msg`: list and show message types, and generate classes for Python and Unity."""

from __future__ import annotations

import os
from pathlib import Path

import typer

from armcell.cli.console import console, err
from armcell.core import InputError, UnknownNameError

app = typer.Typer(help="Message types: list, show, generate classes.", no_args_is_help=True)
FROM = typer.Option(None, "--from", metavar="FOLDER", help="Own definitions: FOLDER/<package>/msg/<Name>.msg")


def _schema(folder: Path | None):
    from armcell.ros.schema import Schema, schema

    if folder is None:
        return schema()
    if not os.path.isdir(folder):
        raise InputError("is not a folder", file=folder)
    return Schema(folder)


@app.command("list")
def list_types(
    package: str | None = typer.Argument(None, help="Only this package, e.g. moveit_msgs."),
    folder: Path | None = FROM,
) -> None:
    """List the message types (messages, services and actions) with their md5 sums."""
    schema = _schema(folder)
    names = [*schema.messages, *schema.services]
    packages = {name.split("/")[0] for name in names}
    if package is not None and package not in packages:
        raise UnknownNameError("message package", package, packages)
    for name in sorted(names):
        if package is None or name.startswith(f"{package}/"):
            kind = "srv" if name in schema.services else "msg"
            console.print(f"{kind}  {schema.md5(name)}  {name}", soft_wrap=True, markup=False)


@app.command("show")
def show(
    name: str = typer.Argument(..., help="A type, e.g. sensor_msgs/JointState or std_srvs/Trigger."),
    full: bool = typer.Option(False, "--full", help="With the definitions of all nested types."),
    folder: Path | None = FROM,
) -> None:
    """Show the definition and the md5 sum of a message type."""
    from armcell.ros.definitions import plain_name

    schema = _schema(folder)
    name = plain_name(name)
    text = schema.full_text if full else schema.text
    if name in schema.services:
        parts = [text(f"{name}Request"), text(f"{name}Response")]
    elif name in schema.actions:
        parts = [text(name + part) for part in ("Goal", "Result", "Feedback")]
    else:
        parts = [text(name)]
    console.print("---\n".join(parts), end="", soft_wrap=True, markup=False)
    if name not in schema.actions:
        console.print(f"# md5 {schema.md5(name)}", markup=False)


@app.command("generate")
def generate(
    packages: list[str] = typer.Argument(None, help="Packages; with --csharp by default those Unity lacks."),
    csharp: Path | None = typer.Option(
        None, "--csharp", metavar="FOLDER", help="Write C# classes for Unity."
    ),
    python: Path | None = typer.Option(None, "--python", metavar="FOLDER", help="Write Python classes."),
    folder: Path | None = FROM,
) -> None:
    """Generate message classes: in C# for Unity's ROS-TCP-Connector, in Python for scripts and editors."""
    from armcell.ros.message_generators import NOT_SHIPPED, write
    from armcell.ros.message_generators import generate_csharp as csharp_files
    from armcell.ros.message_generators import generate_python as python_files

    schema = _schema(folder)
    if csharp is None and python is None:
        raise InputError("nothing to write", hint="give --csharp FOLDER, --python FOLDER or both")
    for target, files in ((csharp, csharp_files), (python, python_files)):
        if target is None:
            continue
        try:
            written = write(files(schema, packages or NOT_SHIPPED), target)
        except OSError as error:
            raise InputError(f"cannot write there ({error.strerror})", file=error.filename) from None
        err(f"{len(written)} files in {target}")
