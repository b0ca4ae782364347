"""Sensors: their block, and measurements that are functions of the state, such as a camera's."""
