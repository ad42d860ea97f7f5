"""A running sum against the exact one."""

import math
import random

from canhaptic.control.balance import RunningSum, add


def test_a_sum_of_terms_of_every_size_is_exact_to_the_last_place() -> None:
    for seed in range(20):
        draw = random.Random(seed)
        running, terms = RunningSum(), []
        for _ in range(400):
            terms.append(draw.uniform(-1.0, 1.0) * 10.0 ** draw.randint(-12, 12))
            if draw.random() < 0.3:
                terms.append(-terms[draw.randrange(len(terms))])
        found = [add(running, term) for term in terms][-1]
        exact = math.fsum(terms)
        assert found == running.value
        assert math.isclose(found, exact, rel_tol=1e-12, abs_tol=1e-15)
