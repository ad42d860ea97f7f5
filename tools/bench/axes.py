"""What does each further axis cost? 1, 2, 3, 6 and 12 axes on one bus, the full stack flat out, in one thread.

All run at the rate that twelve axes leave on 1 Mbit/s, so that the work of one axis is the same in every row; in
lock-step the rate does not pace anything. Without logs: they are another process's work for the most part.
"""

from functools import partial
from time import perf_counter

from canhaptic.scene.build import build
from canhaptic.view.picture_style import BLUE, drawing, save_picture
from tools.bench.demo import demo_of
from tools.bench.report import Row, in_turn, picture_place, publish

PICTURE = "axes.png"
AXES = (1, 2, 3, 6, 12)
RATE = 250  # [Hz]
CYCLES = 2_000
REPEATS = 5
TARGET_OF_THREE = 5_000.0  # [cycles/s]
NEAR_LINEAR = 1.25  # largest cost of an added axis over that of the second


def cost(axes: int) -> float:
    """Returns the time of one cycle [s]."""
    with build(demo_of(axes, RATE), "free") as experiment:
        experiment.rig.start()
        step = experiment.cycle.step
        start = perf_counter()
        for _ in range(CYCLES):
            step()
        elapsed = perf_counter() - start
        experiment.rig.stop()
    return elapsed / CYCLES


def draw(costs: dict[int, float]) -> None:
    """Draws the time of a cycle over the number of axes, and the line through the first two."""
    with drawing() as figure_type:
        figure = figure_type(figsize=(6.0, 3.4), dpi=120, layout="constrained")
        plot = figure.subplots()
        axes = list(costs)
        added = 1e6 * (costs[axes[-1]] - costs[1]) / (axes[-1] - 1)
        plot.plot(axes, [1e6 * value for value in costs.values()], "o-", color=BLUE)
        for count in axes:
            words = f"{1e6 * costs[count]:.0f} us"
            plot.annotate(words, (count, 1e6 * costs[count]), xytext=(4, -12), textcoords="offset points", fontsize=8.0)
        plot.set_title(f"one cycle, flat out: {added:.0f} us more for each axis", fontweight="bold")
        plot.set(xlabel="axes on one bus", ylabel="time of one cycle [us]", xlim=(0, max(axes) + 1), ylim=(0, None))
        plot.set_xticks(axes)
        save_picture(figure, picture_place(PICTURE))


def main() -> None:
    """Measures, draws and publishes."""
    measured = in_turn({axes: partial(cost, axes) for axes in AXES}, REPEATS)
    costs = {axes: min(values) for axes, values in measured.items()}
    draw(costs)
    added = {axes: (costs[axes] - costs[1]) / (axes - 1) for axes in AXES[1:]}
    rows = []
    for axes in AXES:
        rate = 1.0 / costs[axes]
        target, met = (f">= {TARGET_OF_THREE:g}", rate >= TARGET_OF_THREE) if axes == 3 else ("", None)
        rows.append(Row(f"{axes} axes, best of {REPEATS}", rate, "cycles/s", target=target, met=met))
    rows += [
        Row(
            f"each added axis, of {axes}",
            1e6 * cost_added,
            "us",
            "the second axis",
            1e6 * added[2],
            cost_added / added[2],
            target=f"<= {NEAR_LINEAR:g} times",
            met=cost_added <= NEAR_LINEAR * added[2],
        )
        for axes, cost_added in added.items()
    ]
    publish("axes", rows, ["canhaptic", "python-can", "numpy"])


if __name__ == "__main__":
    main()
