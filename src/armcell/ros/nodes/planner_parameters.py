"""Planner parameters of move_group: its services that list planners and get or set their parameters."""

from __future__ import annotations

import logging
from typing import Any

from armcell.core import UnknownNameError
from armcell.planning import pipelines, planner_defaults
from armcell.ros.schema import Schema

logger = logging.getLogger(__name__)


class PlannerParameters:
    """Parameters that clients of move_group set for planners, by pipeline, planner and planning group."""

    def __init__(self, schema: Schema):
        self._schema = schema
        self._values: dict[tuple[str, str, str], dict[str, str]] = {}

    def query(self, request: Any) -> Any:
        described = [
            self._schema.new(
                "moveit_msgs/PlannerInterfaceDescription", f"armcell {name}", name, sorted(table)
            )
            for name, table in pipelines.items()
        ]
        return self._schema.new("moveit_msgs/QueryPlannerInterfacesResponse", described)

    def of(self, request: Any) -> dict[str, Any]:
        """Return the planner parameters for a move_group request. Group-specific values take precedence."""
        key = (request.pipeline_id, request.planner_id)
        return {
            **self._values.get((*key, ""), {}),
            **self._values.get((*key, request.group_name), {}),
        }

    def get(self, request: Any) -> Any:
        key = (request.pipeline_id, request.planner_config)
        try:
            values = {k: str(v) for k, v in planner_defaults(*key).items()}
        except UnknownNameError as error:
            logger.warning("%s", error)
            return self._schema.new("moveit_msgs/GetPlannerParamsResponse")
        values |= self._values.get((*key, ""), {})
        values |= self._values.get((*key, request.group), {}) if request.group else {}
        params = self._schema.new(
            "moveit_msgs/PlannerParams", list(values), list(values.values()), [""] * len(values)
        )
        return self._schema.new("moveit_msgs/GetPlannerParamsResponse", params)

    def set(self, request: Any) -> Any:
        key = (request.pipeline_id, request.planner_config, request.group)
        given = dict(zip(request.params.keys, request.params.values))
        self._values[key] = given if request.replace else {**self._values.get(key, {}), **given}
        return self._schema.new("moveit_msgs/SetPlannerParamsResponse")
