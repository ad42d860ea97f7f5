"""Commissioning: tests that lead from an untried drive to a measured configuration, zero torque first.

    scan and identify -> rest at zero torque -> move by hand -> pulse -> sweep -> silence the master -> time the cycle

Each step runs the whole rig with the limiter, the link policy and the stop of any other run; only the torques are
precomputed (`session.py`). A step that applies torque asks first.
"""
