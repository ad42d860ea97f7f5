"""Choice of the stepper: interpreted, or compiled by numba, which is imported only then."""

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.hybrid_automaton import HybridAutomaton


def machine_type(compiled: bool) -> type[HybridAutomaton]:
    """Return the machine whose holds are interpreted, or compiled.

    Raises:
        ParameterError: numba is not installed.
    """
    if not compiled:
        return HybridAutomaton
    try:
        from canhaptic.sim.plant.njit_stepper import CompiledMachine
    except ImportError as error:
        from canhaptic.extras import install_hint

        raise ParameterError(
            f"compiled: needs numba ({error}); {install_hint('fast')}, or leave it out", "compiled"
        ) from error
    return CompiledMachine
