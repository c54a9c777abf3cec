"""Checks of recordings by the rules of a `checks.yaml`: on a robot, on the server, and in an action.

Pure: reads recordings through `kleinkram.recordings`; knows no server.
"""
