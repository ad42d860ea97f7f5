"""A loop of your own, without CAN: the guard, an account, and a mass that you integrate."""

from canhaptic.passivity import GuardedParameters, Ledger, LoopProperties, SpringDamperWall, build_controller

T = 1e-3  # [s]
wall = SpringDamperWall(stiffness=2000.0, damping=2.0, position=0.0)
loop = LoopProperties(sample_time=T, moving_mass=0.2, device_damping_bound=0.1)
guard = build_controller(wall, "guarded", GuardedParameters(hand_force=2.0), loop)
account, position, speed, force = Ledger(), 0.01, -0.3, 0.0

for k in range(1000):
    balance = guard.step(position, force)  # the position now, and the force held until now
    account.add(balance, k)
    force = balance.torque  # [N]: send it to your motor; here it moves a mass of 0.25 kg
    position += speed * T + 0.5 * force / 0.25 * T**2
    speed += force / 0.25 * T

if __name__ == "__main__":
    print(account.summary())
