"""Commissioning: from an untried drive to a configuration that has been measured, zero torque first.

    scan and identify -> rest at zero torque -> move by hand -> pulse -> sweep -> silence the master -> time

Each step is a run of the whole rig, through the limiter, the link policy and the stop of every other run; only the
source of the torque differs (`session.py`). A step that applies torque asks first.
"""
