"""The generator of the encoder's noise is splitmix64, by its published first numbers for the seed 0."""

from canhaptic.sim.plant.effects import encoder_noise


def test_the_mixed_numbers_are_those_of_splitmix64():
    found = [encoder_noise._mix(number * encoder_noise._GAMMA) for number in (1, 2, 3)]
    assert found == [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F]
