"""A bus, and a ROS-TCP server on it."""

import pytest
from tests.ros.tcp_helpers import ANY_PORT

from armcell.ros import Bus
from armcell.ros.tcp import RosTcpServer


@pytest.fixture
def bus():
    return Bus()


@pytest.fixture
def server(bus):
    with RosTcpServer(bus, ANY_PORT) as server:
        yield server
