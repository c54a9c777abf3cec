"""Fault injection into real processes: kills, full disks, cut connections, wrong clocks."""
