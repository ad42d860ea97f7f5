"""One room for what limits and ends every torque: limiter, link policy, power states, stop. It knows no bus."""
