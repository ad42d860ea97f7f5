"""A LeRobot arm that follows the handle, whose load is felt as a wall. Not run: no arm was at hand.

The handle is the leader: its position is the target of one joint. Where the joint stays behind its target by more than
a threshold it has met something, and the hand feels a wall where the joint is. No energy is booked: the arm gives none.
"""

from pathlib import Path

from lerobot.robots.so101_follower import SO101Follower, SO101FollowerConfig

import canhaptic

RIG = Path(__file__).resolve().parents[2] / "configs" / "far_world.yaml"
JOINT, PER_METRE, BEHIND = "shoulder_lift.pos", 500.0, 3.0  # units of the joint for a metre of the handle

if __name__ == "__main__":
    arm = SO101Follower(SO101FollowerConfig(port="/dev/ttyACM0", id="follower"))
    arm.connect()
    held = arm.get_observation()
    start = held[JOINT]
    try:
        with canhaptic.World("loopback", scene=RIG) as world:
            for hand in world:
                x = hand["handle"].position
                arm.send_action({JOINT: start + PER_METRE * x})
                reached = arm.get_observation()[JOINT]  # some 10 ms: the arm sets the pace of this loop
                behind = start + PER_METRE * x - reached
                if abs(behind) > BEHIND:
                    side = "-" if behind > 0.0 else "+"
                    world["handle"].wall(at=(reached - start) / PER_METRE, stiffness=1000.0, pushes=side, damping=5.0)
                else:
                    world["handle"].free()
    finally:
        arm.disconnect()
