"""In scenes whose declarations are true, the account never claims what the simulated plant denies.

`make bench Q=truth` runs thousands of such scenes and makes one with a false claim smaller (`--only SEED`).
"""

import pytest

from tools.bench.truth import is_false, outcome_of, table_of
from tools.truth.judge import Outcome

SCENES = 150
KNOWN: dict[str, str] = {}
"""Named by a scene with a false claim, and why. Each is needed: what is mended must go from here."""


def _outcomes() -> list[Outcome]:
    return [outcome_of(seed) for seed in range(SCENES)]


class TestNoFalseClaim:
    @pytest.mark.timeout(400)  # 12 s of an idle processor
    def test_only_where_it_is_known(self):
        outcomes = _outcomes()
        wrong = [outcome for outcome in outcomes if is_false(outcome)]
        unknown = {o.seed: o.false_claims for o in wrong if not KNOWN.keys() & set(o.tags)}
        assert unknown == {}
        alone = [KNOWN.keys() & set(outcome.tags) for outcome in wrong]
        needless = [tag for tag in KNOWN if {tag} not in alone]
        assert needless == [], "mended: take it out of KNOWN"
        counted = [outcome for outcome in outcomes if outcome.counts]
        assert len(counted) > 0.85 * SCENES
        assert table_of(outcomes)[0]["runs"] == len(counted)
