"""The CiA 402 profile: power states, bring-up steps, limiter, link policy. Knows objects, not frames."""
