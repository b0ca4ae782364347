"""Connections that several wires share: to MQTT brokers and OPC UA servers, and the OPC UA server of this process."""
