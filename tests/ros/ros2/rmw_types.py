"""ROS 2's messages as rmw_cyclonedds_cpp puts them on DDS, written by hand: nothing here comes from armcell.

Sources: the .msg, .srv and .action files of Jazzy, and rmw_cyclonedds_cpp's request header.
"""

from dataclasses import dataclass, field

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import (
    array,
    bounded_str,
    float64,
    int8,
    int32,
    int64,
    sequence,
    uint8,
    uint16,
    uint32,
    uint64,
)


def dds(name, kind="msg"):
    package, item = name.split("/")
    return f"{package}.{kind}.dds_.{item}_"


@dataclass
class Time(IdlStruct, typename=dds("builtin_interfaces/Time")):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Duration(IdlStruct, typename=dds("builtin_interfaces/Duration")):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename=dds("std_msgs/Header")):
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class String(IdlStruct, typename=dds("std_msgs/String")):
    data: str = ""


@dataclass
class Float64(IdlStruct, typename=dds("std_msgs/Float64")):
    data: float64 = 0.0


@dataclass
class Clock(IdlStruct, typename=dds("rosgraph_msgs/Clock")):
    clock: Time = field(default_factory=Time)


@dataclass
class JointState(IdlStruct, typename=dds("sensor_msgs/JointState")):
    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=list)
    position: sequence[float64] = field(default_factory=list)
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)


@dataclass
class Point(IdlStruct, typename=dds("geometry_msgs/Point")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename=dds("geometry_msgs/Quaternion")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose(IdlStruct, typename=dds("geometry_msgs/Pose")):
    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class PoseStamped(IdlStruct, typename=dds("geometry_msgs/PoseStamped")):
    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)


@dataclass
class Vector3(IdlStruct, typename=dds("geometry_msgs/Vector3")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Transform(IdlStruct, typename=dds("geometry_msgs/Transform")):
    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass
class TransformStamped(IdlStruct, typename=dds("geometry_msgs/TransformStamped")):
    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)


@dataclass
class TFMessage(IdlStruct, typename=dds("tf2_msgs/TFMessage")):
    transforms: sequence[TransformStamped] = field(default_factory=list)


# --- services ---
@dataclass
class TriggerRequest(IdlStruct, typename=dds("std_srvs/Trigger_Request", "srv")):
    guid: uint64 = 0
    seq: int64 = 0
    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class TriggerResponse(IdlStruct, typename=dds("std_srvs/Trigger_Response", "srv")):
    guid: uint64 = 0
    seq: int64 = 0
    success: bool = False
    message: str = ""


# --- actions ---
@dataclass
class UUID(IdlStruct, typename=dds("unique_identifier_msgs/UUID")):
    uuid: array[uint8, 16] = field(default_factory=lambda: [0] * 16)


@dataclass
class GoalInfo(IdlStruct, typename=dds("action_msgs/GoalInfo")):
    goal_id: UUID = field(default_factory=UUID)
    stamp: Time = field(default_factory=Time)


@dataclass
class GoalStatus(IdlStruct, typename=dds("action_msgs/GoalStatus")):
    goal_info: GoalInfo = field(default_factory=GoalInfo)
    status: int8 = 0


@dataclass
class GoalStatusArray(IdlStruct, typename=dds("action_msgs/GoalStatusArray")):
    status_list: sequence[GoalStatus] = field(default_factory=list)


@dataclass
class CancelGoalRequest(IdlStruct, typename=dds("action_msgs/CancelGoal_Request", "srv")):
    guid: uint64 = 0
    seq: int64 = 0
    goal_info: GoalInfo = field(default_factory=GoalInfo)


@dataclass
class CancelGoalResponse(IdlStruct, typename=dds("action_msgs/CancelGoal_Response", "srv")):
    guid: uint64 = 0
    seq: int64 = 0
    return_code: int8 = 0
    goals_canceling: sequence[GoalInfo] = field(default_factory=list)


@dataclass
class GripperCommand(IdlStruct, typename=dds("control_msgs/GripperCommand")):
    position: float64 = 0.0
    max_effort: float64 = 0.0


@dataclass
class GripperGoal(IdlStruct, typename=dds("control_msgs/GripperCommand_Goal", "action")):
    command: GripperCommand = field(default_factory=GripperCommand)


@dataclass
class GripperState(IdlStruct, typename=dds("control_msgs/GripperCommand_Result", "action")):
    position: float64 = 0.0
    effort: float64 = 0.0
    stalled: bool = False
    reached_goal: bool = False


@dataclass
class GripperSendGoalRequest(
    IdlStruct, typename=dds("control_msgs/GripperCommand_SendGoal_Request", "action")
):
    guid: uint64 = 0
    seq: int64 = 0
    goal_id: UUID = field(default_factory=UUID)
    goal: GripperGoal = field(default_factory=GripperGoal)


@dataclass
class GripperSendGoalResponse(
    IdlStruct, typename=dds("control_msgs/GripperCommand_SendGoal_Response", "action")
):
    guid: uint64 = 0
    seq: int64 = 0
    accepted: bool = False
    stamp: Time = field(default_factory=Time)


@dataclass
class GripperGetResultRequest(
    IdlStruct, typename=dds("control_msgs/GripperCommand_GetResult_Request", "action")
):
    guid: uint64 = 0
    seq: int64 = 0
    goal_id: UUID = field(default_factory=UUID)


@dataclass
class GripperGetResultResponse(
    IdlStruct, typename=dds("control_msgs/GripperCommand_GetResult_Response", "action")
):
    guid: uint64 = 0
    seq: int64 = 0
    status: int8 = 0
    result: GripperState = field(default_factory=GripperState)


@dataclass
class GripperFeedbackMessage(
    IdlStruct, typename=dds("control_msgs/GripperCommand_FeedbackMessage", "action")
):
    goal_id: UUID = field(default_factory=UUID)
    feedback: GripperState = field(default_factory=GripperState)


@dataclass
class JointTrajectoryPoint(IdlStruct, typename=dds("trajectory_msgs/JointTrajectoryPoint")):
    positions: sequence[float64] = field(default_factory=list)
    velocities: sequence[float64] = field(default_factory=list)
    accelerations: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)
    time_from_start: Duration = field(default_factory=Duration)


@dataclass
class JointTrajectory(IdlStruct, typename=dds("trajectory_msgs/JointTrajectory")):
    header: Header = field(default_factory=Header)
    joint_names: sequence[str] = field(default_factory=list)
    points: sequence[JointTrajectoryPoint] = field(default_factory=list)


@dataclass
class Twist(IdlStruct, typename=dds("geometry_msgs/Twist")):
    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass
class MultiDOFPoint(IdlStruct, typename=dds("trajectory_msgs/MultiDOFJointTrajectoryPoint")):
    transforms: sequence[Transform] = field(default_factory=list)
    velocities: sequence[Twist] = field(default_factory=list)
    accelerations: sequence[Twist] = field(default_factory=list)
    time_from_start: Duration = field(default_factory=Duration)


@dataclass
class MultiDOFTrajectory(IdlStruct, typename=dds("trajectory_msgs/MultiDOFJointTrajectory")):
    header: Header = field(default_factory=Header)
    joint_names: sequence[str] = field(default_factory=list)
    points: sequence[MultiDOFPoint] = field(default_factory=list)


@dataclass
class JointTolerance(IdlStruct, typename=dds("control_msgs/JointTolerance")):
    name: str = ""
    position: float64 = 0.0
    velocity: float64 = 0.0
    acceleration: float64 = 0.0


@dataclass
class JointComponentTolerance(IdlStruct, typename=dds("control_msgs/JointComponentTolerance")):
    joint_name: str = ""
    component: uint16 = 0
    position: float64 = 0.0
    velocity: float64 = 0.0
    acceleration: float64 = 0.0


@dataclass
class FollowGoal(IdlStruct, typename=dds("control_msgs/FollowJointTrajectory_Goal", "action")):
    trajectory: JointTrajectory = field(default_factory=JointTrajectory)
    multi_dof_trajectory: MultiDOFTrajectory = field(default_factory=MultiDOFTrajectory)
    path_tolerance: sequence[JointTolerance] = field(default_factory=list)
    component_path_tolerance: sequence[JointComponentTolerance] = field(default_factory=list)
    goal_tolerance: sequence[JointTolerance] = field(default_factory=list)
    component_goal_tolerance: sequence[JointComponentTolerance] = field(default_factory=list)
    goal_time_tolerance: Duration = field(default_factory=Duration)


@dataclass
class FollowResult(IdlStruct, typename=dds("control_msgs/FollowJointTrajectory_Result", "action")):
    error_code: int32 = 0
    error_string: str = ""


@dataclass
class FollowFeedback(IdlStruct, typename=dds("control_msgs/FollowJointTrajectory_Feedback", "action")):
    header: Header = field(default_factory=Header)
    joint_names: sequence[str] = field(default_factory=list)
    desired: JointTrajectoryPoint = field(default_factory=JointTrajectoryPoint)
    actual: JointTrajectoryPoint = field(default_factory=JointTrajectoryPoint)
    error: JointTrajectoryPoint = field(default_factory=JointTrajectoryPoint)
    multi_dof_joint_names: sequence[str] = field(default_factory=list)
    multi_dof_desired: MultiDOFPoint = field(default_factory=MultiDOFPoint)
    multi_dof_actual: MultiDOFPoint = field(default_factory=MultiDOFPoint)
    multi_dof_error: MultiDOFPoint = field(default_factory=MultiDOFPoint)


FOLLOW = "control_msgs/FollowJointTrajectory"


@dataclass
class FollowSendGoalRequest(IdlStruct, typename=dds(f"{FOLLOW}_SendGoal_Request", "action")):
    guid: uint64 = 0
    seq: int64 = 0
    goal_id: UUID = field(default_factory=UUID)
    goal: FollowGoal = field(default_factory=FollowGoal)


@dataclass
class FollowSendGoalResponse(IdlStruct, typename=dds(f"{FOLLOW}_SendGoal_Response", "action")):
    guid: uint64 = 0
    seq: int64 = 0
    accepted: bool = False
    stamp: Time = field(default_factory=Time)


@dataclass
class FollowGetResultRequest(IdlStruct, typename=dds(f"{FOLLOW}_GetResult_Request", "action")):
    guid: uint64 = 0
    seq: int64 = 0
    goal_id: UUID = field(default_factory=UUID)


@dataclass
class FollowGetResultResponse(IdlStruct, typename=dds(f"{FOLLOW}_GetResult_Response", "action")):
    guid: uint64 = 0
    seq: int64 = 0
    status: int8 = 0
    result: FollowResult = field(default_factory=FollowResult)


@dataclass
class FollowFeedbackMessage(IdlStruct, typename=dds(f"{FOLLOW}_FeedbackMessage", "action")):
    goal_id: UUID = field(default_factory=UUID)
    feedback: FollowFeedback = field(default_factory=FollowFeedback)


@dataclass
class MoveItErrorCodes(IdlStruct, typename=dds("moveit_msgs/MoveItErrorCodes")):
    val: int32 = 0
    message: str = ""
    source: str = ""


@dataclass
class RobotTrajectory(IdlStruct, typename=dds("moveit_msgs/RobotTrajectory")):
    joint_trajectory: JointTrajectory = field(default_factory=JointTrajectory)
    multi_dof_joint_trajectory: MultiDOFTrajectory = field(default_factory=MultiDOFTrajectory)


EXECUTE = "moveit_msgs/ExecuteTrajectory"


@dataclass
class ExecuteGoal(IdlStruct, typename=dds(f"{EXECUTE}_Goal", "action")):
    trajectory: RobotTrajectory = field(default_factory=RobotTrajectory)
    controller_names: sequence[str] = field(default_factory=list)


@dataclass
class ExecuteResult(IdlStruct, typename=dds(f"{EXECUTE}_Result", "action")):
    error_code: MoveItErrorCodes = field(default_factory=MoveItErrorCodes)


@dataclass
class ExecuteSendGoalRequest(IdlStruct, typename=dds(f"{EXECUTE}_SendGoal_Request", "action")):
    guid: uint64 = 0
    seq: int64 = 0
    goal_id: UUID = field(default_factory=UUID)
    goal: ExecuteGoal = field(default_factory=ExecuteGoal)


@dataclass
class ExecuteSendGoalResponse(IdlStruct, typename=dds(f"{EXECUTE}_SendGoal_Response", "action")):
    guid: uint64 = 0
    seq: int64 = 0
    accepted: bool = False
    stamp: Time = field(default_factory=Time)


@dataclass
class ExecuteGetResultRequest(IdlStruct, typename=dds(f"{EXECUTE}_GetResult_Request", "action")):
    guid: uint64 = 0
    seq: int64 = 0
    goal_id: UUID = field(default_factory=UUID)


@dataclass
class ExecuteGetResultResponse(IdlStruct, typename=dds(f"{EXECUTE}_GetResult_Response", "action")):
    guid: uint64 = 0
    seq: int64 = 0
    status: int8 = 0
    result: ExecuteResult = field(default_factory=ExecuteResult)


# --- parameters ---
@dataclass
class ParameterValue(IdlStruct, typename=dds("rcl_interfaces/ParameterValue")):
    type: uint8 = 0
    bool_value: bool = False
    integer_value: int64 = 0
    double_value: float64 = 0.0
    string_value: str = ""
    byte_array_value: sequence[uint8] = field(default_factory=list)
    bool_array_value: sequence[bool] = field(default_factory=list)
    integer_array_value: sequence[int64] = field(default_factory=list)
    double_array_value: sequence[float64] = field(default_factory=list)
    string_array_value: sequence[str] = field(default_factory=list)


@dataclass
class Parameter(IdlStruct, typename=dds("rcl_interfaces/Parameter")):
    name: str = ""
    value: ParameterValue = field(default_factory=ParameterValue)


@dataclass
class SetParametersResult(IdlStruct, typename=dds("rcl_interfaces/SetParametersResult")):
    successful: bool = False
    reason: str = ""


@dataclass
class ListParametersResult(IdlStruct, typename=dds("rcl_interfaces/ListParametersResult")):
    names: sequence[str] = field(default_factory=list)
    prefixes: sequence[str] = field(default_factory=list)


@dataclass
class ListParametersRequest(IdlStruct, typename=dds("rcl_interfaces/ListParameters_Request", "srv")):
    guid: uint64 = 0
    seq: int64 = 0
    prefixes: sequence[str] = field(default_factory=list)
    depth: uint64 = 0


@dataclass
class ListParametersResponse(IdlStruct, typename=dds("rcl_interfaces/ListParameters_Response", "srv")):
    guid: uint64 = 0
    seq: int64 = 0
    result: ListParametersResult = field(default_factory=ListParametersResult)


@dataclass
class GetParametersRequest(IdlStruct, typename=dds("rcl_interfaces/GetParameters_Request", "srv")):
    guid: uint64 = 0
    seq: int64 = 0
    names: sequence[str] = field(default_factory=list)


@dataclass
class GetParametersResponse(IdlStruct, typename=dds("rcl_interfaces/GetParameters_Response", "srv")):
    guid: uint64 = 0
    seq: int64 = 0
    values: sequence[ParameterValue] = field(default_factory=list)


@dataclass
class SetParametersRequest(IdlStruct, typename=dds("rcl_interfaces/SetParameters_Request", "srv")):
    guid: uint64 = 0
    seq: int64 = 0
    parameters: sequence[Parameter] = field(default_factory=list)


@dataclass
class SetParametersResponse(IdlStruct, typename=dds("rcl_interfaces/SetParameters_Response", "srv")):
    guid: uint64 = 0
    seq: int64 = 0
    results: sequence[SetParametersResult] = field(default_factory=list)


# --- discovery ---
@dataclass
class Gid(IdlStruct, typename=dds("rmw_dds_common/Gid")):
    data: array[uint8, 16] = field(default_factory=lambda: [0] * 16)


@dataclass
class NodeEntitiesInfo(IdlStruct, typename=dds("rmw_dds_common/NodeEntitiesInfo")):
    node_namespace: bounded_str[256] = ""
    node_name: bounded_str[256] = ""
    reader_gid_seq: sequence[Gid] = field(default_factory=list)
    writer_gid_seq: sequence[Gid] = field(default_factory=list)


@dataclass
class ParticipantEntitiesInfo(IdlStruct, typename=dds("rmw_dds_common/ParticipantEntitiesInfo")):
    gid: Gid = field(default_factory=Gid)
    node_entities_info_seq: sequence[NodeEntitiesInfo] = field(default_factory=list)
