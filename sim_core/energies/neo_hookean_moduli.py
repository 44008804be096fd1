"""Moduli of the elements of a gel, and how much of the bulk modulus acts point by point.

Near incompressibility a bulk energy K/2 (J - 1)^2 at all four quadrature points is too stiff, and one on
the mean dilatation of each element alone too soft. The two are mixed: the pointwise part has the
stiffness K_own with 1/K_own = 1/K + 1/(6 mu), the mean takes the rest,

    V K/2 (J - 1)^2  ->  sum_q w_q K_own/2 (J_q - 1)^2  +  V (K - K_own)/2 (mean_q J_q - 1)^2,    mean_q: with w_q / V

The mean is that of one element, so elements of different nu share no pressure: the energy of each has its own mu, K
and K_own. Uniform strain is not affected (straight elements reproduce it exactly; on the curved ones of a coarse dome
the four-point rule leaves 0.6 % of the largest nodal force unbalanced, 0.2 % after one refinement).
Error of the apparent modulus of a disc bonded to two plates, S = R/2t, against an axisymmetric solution
that is converged to 0.2 %; pointwise / this mixture / mean alone [%]:

    cells of the disc      S = 1, nu 0.45     S = 1, nu 0.49      S = 2.5, nu 0.45    S = 2.5, nu 0.49
    (2, 1, 1)   60 tets    16 / 12 /  5       79 / 34 / 19        6.4 / 4.8 /  1.7    19  /  4.9 /  -5.8
    (2, 1, 2)  120 tets    5.6 / 3.8 / -4.0   10.9 / 5.6 / -8.6   3.4 / 1.7 / -3.2    5.0 / -4.3 / -19.9
    (2, 2, 2)  200 tets    5.2 / 3.8 / -2.1   10.0 / 6.1 / -4.5   2.9 / 1.7 / -2.6    4.2 / -1.6 / -15.2
    (4, 2, 2)  480 tets    4.7 / 3.4 / -2.2   10.0 / 6.2 / -3.5   2.2 / 1.3 / -2.8    3.8 /  0.0 / -11.8

So a bonded layer wants at least two cells through its thickness. At nu = 0.3 all three are within 1.3 %
from there on.
"""

import numpy as np

# Places in the rows of moduli that the kernels read: mu and K [Pa], and K_own / K [-].
MU, BULK, OWN = range(3)

_OWN_STIFFNESS = 6.0
"""How far the bulk modulus acts point by point, over mu; chosen by measurement, see the module text."""


def moduli(young: float, nu: np.ndarray) -> np.ndarray:
    """mu, K [Pa] and K_own / K of elements with the ratios ``nu`` ``(m,)``, ``(m, 3)``."""
    mu, lam = young / 2.0 / (1.0 + nu), young * nu / (1.0 + nu) / (1.0 - 2.0 * nu)
    bulk = lam + 2.0 * mu / 3.0
    return np.column_stack([mu, bulk, _OWN_STIFFNESS * mu / (bulk + _OWN_STIFFNESS * mu)])


def apart(numbers: np.ndarray) -> np.ndarray:
    """mu, K_own and K - K_own [Pa], in which forces are linear, of moduli ``(m, 3)``, or slopes in their place."""
    mu, bulk, own = numbers.T
    return np.column_stack([mu, bulk * own, bulk * (1.0 - own)])


def moduli_by_nu(young: float, nu: np.ndarray) -> np.ndarray:
    """What to put in place of the moduli, ``(m, 3)``, in forces that are linear in mu, K_own and K - K_own, for their
    derivatives by ``nu``: dmu/dnu, dK/dnu [Pa] and dK_own/dK. With K = E / (3 (1 - 2 nu)) and s = 6

        dK_own/dK = (K_own / K)^2 + s (1 - K_own / K)^2 dmu/dK
    """
    own = moduli(young, nu)[:, OWN]
    by_mu, by_bulk = -young / 2.0 / (1.0 + nu) ** 2, 2.0 / 3.0 * young / (1.0 - 2.0 * nu) ** 2
    return np.column_stack([by_mu, by_bulk, own**2 + _OWN_STIFFNESS * (1.0 - own) ** 2 * by_mu / by_bulk])
