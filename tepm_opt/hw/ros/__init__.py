"""ROS 2 without ROS: topics and services of a running rosbridge, over a websocket.

`bridge` is one connection, `node` keeps one up in a thread of its own, `messages` are what it sends. `publishing` shows a run to ROS or, by
`foxglove`, without it; `rig` drives a robot that ROS nodes stand for; the tracker of this name is a module of `hw.trackers.kinds`.
"""
