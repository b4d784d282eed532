"""rosbridge, the robot's links from /joint_states, and RViz: `ros2 launch tepm_description display.launch.py`."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import Command, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """Three nodes; arguments are the URDF and rosbridge's address and port."""
    share = Path(get_package_share_directory("tepm_description"))
    description = ParameterValue(Command(["cat ", LaunchConfiguration("urdf")]), value_type=str)
    bridge = {"address": LaunchConfiguration("address"), "port": ParameterValue(LaunchConfiguration("port"), value_type=int)}
    return LaunchDescription(
        [
            DeclareLaunchArgument("urdf", default_value=str(share / "urdf" / "kang2017.urdf"), description="written by tepm export urdf"),
            DeclareLaunchArgument("address", default_value="127.0.0.1", description="on which rosbridge listens; it has no password"),
            DeclareLaunchArgument("port", default_value="9090", description="of rosbridge"),
            Node(package="rosbridge_server", executable="rosbridge_websocket", parameters=[bridge]),
            Node(package="robot_state_publisher", executable="robot_state_publisher", parameters=[{"robot_description": description}]),
            Node(package="rviz2", executable="rviz2", arguments=["-d", str(share / "rviz" / "tepm.rviz")]),
        ]
    )
