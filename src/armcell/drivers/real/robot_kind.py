"""Robot kinds: what a vendor contributes to mode `real`, by name; validation of their settings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from armcell.core import InputError, Registry, UnknownNameError
from armcell.drivers.real.arm import RealArm
from armcell.drivers.real.identity import NetworkReport, RobotIdentity, check_not_swapped
from armcell.drivers.real.settings import DEFAULT_KIND, OWN, ArmSettings, RealSettings
from armcell.model import RobotModel

Array = NDArray[np.float64]


A = TypeVar("A", bound=ArmSettings)

I = TypeVar("I", bound=RobotIdentity)


class BackendLibrary(NamedTuple):
    """Python library that a motion backend of a real robot requires: its name, its module, the extra of
    armcell that installs it, and the systems with prebuilt wheels.
    """

    name: str
    module: str  # that Python imports
    extra: str  # of armcell
    wheels: str  # for which systems it has wheels


class RobotKind(ABC, Generic[A, I]):
    """Interface to one kind of real robot, such as UR or Franka. A vendor implements it for execution in mode
    `real`, bring-up and comparison with the simulated twin.

    Attributes:
        arm_settings: model of an arm's block in the cell file.
        joints: number of joints of an arm.
        backends: valid values of `real: backend:`, the default first.
        libraries: the libraries of the backends that need one.
        gripper_hint: how to configure a gripper in the cell file.
        calibrates: robots report the factory calibration of their geometry.
        effort: name and unit of `ArmSample.efforts`.
    """

    arm_settings: ClassVar[type[ArmSettings]]
    joints: ClassVar[int]
    backends: ClassVar[tuple[str, ...]] = ("own",)
    libraries: ClassVar[Mapping[str, BackendLibrary]] = {}
    gripper_hint: ClassVar[str]
    calibrates: ClassVar[bool] = True
    effort: ClassVar[tuple[str, str]] = ("current", "A")

    def complete_settings(self, arms: Mapping[str, A], model: RobotModel) -> dict[str, A]:
        """Let a robot kind check the settings of all its arms for contradictions and fill in default values.

        Raises:
            InputError: two arms contradict each other, or a value is invalid.
        """
        return dict(arms)

    def check_backend(self, backend: str) -> None:
        """Check that all libraries required by the motion backend of a robot kind are installed.

        Raises:
            InputError: a library is missing; the error names the extra to install.
        """
        library = self.libraries.get(backend)
        if library is not None and find_spec(library.module) is None:
            raise InputError(
                f"'backend: {backend}' needs the library {library.name}, which is not installed",
                element="real/backend",
                hint=f"pip install 'armcell[{library.extra}]' (it has wheels {library.wheels}), or leave out "
                "'backend'",
            )

    def controller_description(self, backend: str) -> str:
        """Return a short description of the software that controls the arms of a robot kind with a given
        motion backend, such as "our program" for a UR.
        """
        return backend

    # --- identity and readiness; nothing moves ---
    @abstractmethod
    def identify(self, arm: A) -> I:
        """Query the identity and state of a robot, in the way that its robot kind requires.

        Raises:
            InputError: no robot answers, or the robot is not of this kind.
        """

    @abstractmethod
    def check_identity(self, name: str, arm: A, found: I) -> None:
        """Let a robot kind check that a connected robot is the one that the cell file specifies for an arm.

        Raises:
            InputError: the connected robot is another one.
        """

    @abstractmethod
    def check_ready(self, name: str, found: I) -> None:
        """Check that a robot is ready to be driven, by the criteria of its robot kind, such as UR or Franka.

        Raises:
            InputError: the robot cannot be driven; the message states the remedy.
        """

    @abstractmethod
    def calibrated(self, model: RobotModel, group: str, found: I) -> RobotModel:
        """Return a robot model that includes the factory calibration, which the arm's controller reports.

        Raises:
            InputError: the calibration does not fit the model, or robots of this kind report none.
        """

    @abstractmethod
    def make_arm(
        self, name: str, joint_names: tuple[str, ...], arm: A, limits: RealSettings, found: I,
        on_state: Callable[[], None],
    ) -> RealArm:  # fmt: skip
        """Create a `RealArm` of this robot kind, without connecting to the robot.

        Args:
            name: planning group of the arm.
            limits: supervision limits and backend of the block `real`.
            on_state: the arm calls it after each new state.
        """

    # --- bring-up ---
    @abstractmethod
    def measure_network(self, arm: A) -> NetworkReport:
        """Measure round-trip times and the intervals between state messages on the connection to an arm of
        this robot kind, without moving the arm.
        """

    @abstractmethod
    def power_on(self, name: str, arm: A) -> str:
        """Power on an arm and release its brakes, as its robot kind requires, or ask the operator to do so.

        Returns the result in words.

        Raises:
            InputError: the arm is not ready afterwards; the message states the remedy.
        """

    @abstractmethod
    def measured_positions(self, arm: A) -> Array:
        """Read the measured joint positions (n,) [rad] from the controller of an arm, without a connected
        driver.
        """

    @abstractmethod
    def flange_position(self, found: I, q: Array) -> Array:
        """Compute the flange position (3,) [m] of an arm in its base link from the manufacturer's kinematic
        parameters, independently of the robot model.

        Args:
            q: joint positions (n,) [rad].
        """


robot_kinds: Registry[RobotKind[Any, Any]] = Registry("kind of real robot", "armcell.drivers")

"""Robot kinds by the name that a cell file states in `real: {kind: ...}`."""


def kind_of(arm: ArmSettings) -> RobotKind[Any, Any]:
    """Return the registered robot kind to which an arm belongs.

    Raises:
        UnknownNameError: no kind with this name is installed.
    """
    return robot_kinds[arm.kind]


def identify_all(settings: RealSettings) -> dict[str, RobotIdentity]:
    """Query the identity of each arm's robot, and check that the arms' addresses are not swapped.

    The robot kind of each arm performs the query.

    Raises:
        InputError: a robot does not answer, or the arms' addresses are swapped.
    """
    found = {name: kind_of(arm).identify(arm) for name, arm in settings.arms.items()}
    check_not_swapped(settings.arms, found)
    return found


def check_distinct(arms: Mapping[str, ArmSettings], what: str, key: str) -> None:
    """Check that all arms of a robot kind differ in a setting, such as the address.

    Raises:
        InputError: two arms have the same value.
    """
    owners: dict[Any, str] = {}
    for name, arm in arms.items():
        other = owners.setdefault(getattr(arm, key), name)
        if other != name:
            raise InputError(
                f"arms {other!r} and {name!r} have the same {what} {getattr(arm, key)}",
                element="real/arms", hint=f"every arm needs its own {what}",
            )  # fmt: skip


_NUMBERS = {6: "six", 7: "seven"}


def real_settings(values: dict[str, Any], model: RobotModel) -> RealSettings:
    """Validate the block `real` of a cell file, which describes the real arms.

    Raises:
        InputError: the block is invalid; the message states the cause and the remedy.
    """
    if not values:
        raise InputError(
            "the cell has no real arms",
            hint="add to the cell file 'real: {arms: {GROUP: {host: ADDRESS, model: UR10}}}'; "
            f"groups with six joints: {', '.join(_groups(model, 6)) or 'none'}",
        )
    arms = values.get("arms")
    defaults = {"kind": values.get("kind", DEFAULT_KIND), "backend": values.get("backend", OWN)}
    if isinstance(arms, Mapping):
        values = {**values, "arms": {name: _arm(name, block, defaults) for name, block in arms.items()}}
    settings = _validated(RealSettings, values)
    for name, arm in settings.arms.items():
        kind = kind_of(arm)
        if name not in (groups := _groups(model, kind.joints)):
            raise UnknownNameError(
                f"arm (a planning group with {_NUMBERS.get(kind.joints, kind.joints)} joints)",
                name, groups, element="real/arms",
            )  # fmt: skip
        if arm.backend not in kind.backends:
            place = _place("backend", name, arm.backend == settings.backend)
            raise UnknownNameError(f"backend of kind {arm.kind!r}", arm.backend, kind.backends, element=place)
    check_distinct(settings.arms, "address", "host")
    complete: dict[str, ArmSettings] = {}
    for kind in dict.fromkeys(arm.kind for arm in settings.arms.values()):
        mine = {name: arm for name, arm in settings.arms.items() if arm.kind == kind}
        complete |= robot_kinds[kind].complete_settings(mine, model)
    return settings.model_copy(update={"arms": {name: complete[name] for name in settings.arms}})


def _groups(model: RobotModel, joints: int) -> list[str]:
    return [g.name for g in model.groups.values() if g.tip_link and len(g.joint_names) == joints]


def _place(key: str, arm: str, default: bool) -> str:
    """Return the cell-file path of an arm's setting, for example `real/kind` for the default of all arms, or
    `real/arms/left/kind` for the arm's own value.
    """
    return f"real/{key}" if default else f"real/arms/{arm}/{key}"


def _arm(name: str, block: Any, defaults: dict[str, Any]) -> ArmSettings:
    values = {**defaults, **block} if isinstance(block, Mapping) else block
    kind = values["kind"] if isinstance(values, dict) else defaults["kind"]
    if not isinstance(kind, str) or kind not in robot_kinds:
        place = _place("kind", name, kind == defaults["kind"])
        raise UnknownNameError(robot_kinds.kind, str(kind), robot_kinds, element=place)
    return _validated(robot_kinds[kind].arm_settings, values, "arms", name)


def _validated(kind: type[Any], values: Any, *place: str) -> Any:
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = "/".join(["real", *place, *(str(p) for p in first["loc"])])
        raise InputError(first["msg"].removeprefix("Value error, "), element=where) from None
