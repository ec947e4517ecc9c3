"""Named sliders and what is known of each, to the digits given: first precursor of the semi-infinite chain, lengths in λc, loads in u_s.

The records are plain numbers, so that the independent programs may read them too; `test_problems` holds every one to mpmath and to
dense solves. ℓ is where the polynomial through the stresses on the last six contacts crosses the threshold, ℓ* where the front stress itself
does.
"""

from typing import NamedTuple


class Problem(NamedTuple):
    """A slider, its interface, and its first precursor."""

    height: float  # H/λc
    stiffness: float  # k/K
    poisson: float  # ν
    prestress: float = 0.0  # φ = σ_0/σ_s
    contacts: int = -1  # s0; −1 where the front never stops
    length: float = float("inf")  # ℓ
    exact_length: float = float("inf")  # ℓ*
    load: float = float("nan")  # U0
    status: str = "ARRESTED"  # name of the outcome

    @property
    def slider(self) -> tuple[float, float, float]:
        """(H/λc, k/K, ν)."""
        return self[:3]


# Fig. 2 of the paper, and the sliders beside it whose numbers were worked out before any code (H/λc, k/K)
PAPER = Problem(25.0, 0.03, 0.3, 0.0, 26, 25.7888150219728, 25.7888152614765, 3.1985410172)
SHORT = Problem(10.0, 0.03, 0.3, 0.0, 10, 9.72400058028539, 9.72406039695121, 2.01972563598)
TALL = Problem(50.0, 0.03, 0.3, 0.0, 52, 51.3918958687698, 51.3918958739789, 5.1520784809)
MEDIUM = Problem(25.0, 0.01, 0.3, 0.0, 22, 21.6366919399624, 21.6366928140084, 1.79767776449)
SOFT = Problem(25.0, 0.003, 0.3, 0.0, 16, 15.022732043652, 15.0227321330897, 1.27704840025)
TALL_SOFT = Problem(50.0, 0.003, 0.3, 0.0, 35, 34.650805483033, 34.6508055509383, 1.47357337713)
REFERENCE = (SHORT, PAPER, TALL, MEDIUM, SOFT, TALL_SOFT)

NO_DOMINO = Problem(3.0, 1e-4, 0.3, 0.0, 1, 0.0, 0.0, 1.01387875487, "NO_DOMINO")
"""Short and soft: the neighbour of the contact at the edge stays below its threshold."""

REBREAK = Problem(25.0, 0.1, 0.3, 0.0, 25, 24.894878569278, 24.8948787813869, 7.92563433004, "REBREAK")
"""b = 6.5: contact 0 is back at 1.0447 σ_s when the front stops."""

PRESTRESSED = tuple(
    PAPER._replace(prestress=phi, contacts=s0, length=length, exact_length=exact, load=load)
    for phi, s0, length, exact, load in (
        (0.1, 30, 29.1493900942926, 29.1493901256967, 2.87868691548),
        (0.2, 34, 33.9121811812833, 33.912181218624, 2.55883281376),
        (0.3, 42, 41.4020365803241, 41.4020365995377, 2.23897871204),
        (0.4, 56, 55.7939994430552, 55.7939994468013, 1.91912461032),
        (0.45, 71, 70.6077026181133, 70.6077026180887, 1.75919755946),
        (0.5, 107, 106.46811670243, 106.468116702106, 1.5992705086),
        (0.53, 204, 203.567188600848, 203.567188600796, 1.50331427808),
    )
)
"""PAPER under growing prestress, up to just below run-away."""

RUNAWAY_PRESTRESS = 0.536498642741657
"""φ_c = (1 + G_00)/2 of PAPER."""

RUNAWAY = PAPER._replace(
    prestress=0.54, contacts=-1, length=float("inf"), exact_length=float("inf"), load=1.47132886791, status="RUN_AWAY"
)

STOPS_ABOVE = Problem(6.84029016, 3.56033954e-03, 0.297661153, 0.6085, 8, 7.59045564086685, 7.5905942206214, 0.448957735768)
"""Soft and short: the front stops though φ exceeds φ_c = 0.508, which is necessary but not sufficient."""

RESONANT = Problem(2.0, 0.21417121229652727567, 0.3, 0.0, 2, 1.80895753321945, 1.75242584358166, 2.59525907036)
"""ρ_2 r_2² = ρ_1: a pole of the plain double series."""

LONG = Problem(75_000.0, 1 / (2.6 * 75_000), 0.3, 0.0, 54195, 54194.6893438299, 54194.6893438, 2.00364563067680)
"""b = 1 and λc small, as for a block of 75 mm whose correlation length is a micron; a naive float64 evaluation loses eight digits."""
