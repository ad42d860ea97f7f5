"""The CiA 402 profile: an axis, its parameters and scaling, bring-up steps. Knows objects, not frames."""
