"""Named material data with their sources. They are starting points for a fit, not measurements of yours."""

from __future__ import annotations

from dataclasses import dataclass

from sim_core.errors import ConfigError, nearest_match


@dataclass(frozen=True)
class Preset:
    """Material data in SI units; ``thickness_m`` is None for materials that are no sheets."""

    E_pa: float
    nu: float
    density_kg_m3: float
    thickness_m: float | None
    source: str


PRESETS: dict[str, Preset] = {
    "paper_80gsm": Preset(
        3.0e9,
        0.3,
        800.0,
        1.0e-4,
        "Office paper, 80 g/m^2 on 0.10 mm. Modulus and Poisson's ratio: between the directions of the "
        "sheet, order of magnitude as in Alava & Niskanen, Rep. Prog. Phys. 69 (2006) 669",
    ),
    "card_200gsm": Preset(
        2.5e9,
        0.3,
        800.0,
        2.5e-4,
        "Card, 200 g/m^2 on 0.25 mm. Modulus and Poisson's ratio: as for paper, "
        "Alava & Niskanen, Rep. Prog. Phys. 69 (2006) 669",
    ),
    "pet_film_100um": Preset(
        4.9e9,
        0.38,
        1390.0,
        1.0e-4,
        "Biaxially oriented polyester film: DuPont Teijin Films, Mylar physical-thermal properties H-37232-3 "
        "(modulus 490 kg/mm^2 along and 510 across the machine)",
    ),
    "aluminium_foil": Preset(
        69.0e9,
        0.33,
        2700.0,
        1.6e-5,
        "Aluminium, annealed: ASM Handbook vol. 2 (1990); thickness of household foil",
    ),
    "steel_shim_100um": Preset(
        2.0e11, 0.29, 7850.0, 1.0e-4, "Carbon steel: ASM Handbook vol. 1 (1990); thickness of a shim"
    ),
    "ecoflex_00_30": Preset(
        6.9e4,
        0.49,
        1070.0,
        None,
        "Smooth-On bulletin Ecoflex series: 100 % modulus 10 psi taken as Young's modulus; density. "
        "Tension tests show about half: Marechal et al., Soft Robotics 2020, doi 10.1089/soro.2019.0115",
    ),
    "ecoflex_00_50": Preset(
        8.3e4,
        0.49,
        1070.0,
        None,
        "Smooth-On bulletin Ecoflex series: 100 % modulus 12 psi taken as Young's modulus; density. "
        "Tension tests show about half: Marechal et al., Soft Robotics 2020, doi 10.1089/soro.2019.0115",
    ),
    "dragon_skin_30": Preset(
        5.93e5,
        0.49,
        1080.0,
        None,
        "Smooth-On bulletin Dragon Skin series: 100 % modulus 86 psi taken as Young's modulus; density",
    ),
    "sylgard_184": Preset(
        1.32e6,
        0.49,
        1030.0,
        None,
        "Cured at 25 C: Johnston et al., J. Micromech. Microeng. 24 (2014) 035017; density: Dow data sheet",
    ),
}


def preset_values(name: object) -> dict[str, float]:
    """Values of a preset by the keys of a rig file."""
    if not isinstance(name, str) or name not in PRESETS:
        raise ConfigError(f"There is no material preset {name!r}.", nearest_match(str(name), PRESETS))
    preset = PRESETS[name]
    values = {"E_pa": preset.E_pa, "nu": preset.nu, "density_kg_m3": preset.density_kg_m3}
    if preset.thickness_m is not None:
        values["thickness_m"] = preset.thickness_m
    return values
