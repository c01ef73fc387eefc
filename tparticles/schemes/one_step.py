"""The built-in explicit Runge-Kutta methods: a few lines of numbers each, with their source."""

from __future__ import annotations

from fractions import Fraction

from tparticles.errors import InputError
from tparticles.schemes.exact import Number, shown
from tparticles.schemes.lazy import Lazy, named
from tparticles.schemes.program import Scheme
from tparticles.schemes.runge_kutta import runge_kutta

F = Fraction
_TWO_THIRDS = F(2, 3)


def modified_euler(alpha: Number = _TWO_THIRDS, *, name: str = "modified-euler") -> Scheme:
    """Return Bridson's modified Euler: z = z0 + dt ((1 - alpha) f(z0) + alpha f(z0 + dt f(z0))).

    `alpha` from 1/2 (Heun, order 2) to 1 trades stability on the real axis, 1/alpha, for stability on the imaginary axis,
    sqrt(2 alpha - 1) / alpha.
    Raises InputError if `alpha` is not a number from 0.5 to 1.
    Source: Bridson, CS533D lecture notes (2005), slides 24-25.
    """
    if not isinstance(alpha, int | float | Fraction) or isinstance(alpha, bool) or not 0.5 <= alpha <= 1:
        raise InputError(f"scheme '{name}': alpha must be a number from 0.5 to 1, not {shown(alpha)}")
    reference = "R. Bridson, CS533D Animation Physics, lecture notes (2005), slides 24-25"
    return runge_kutta([[], [1]], [1 - alpha, alpha], name=name, reference=reference)


_dormand_prince = [F(35, 384), 0, F(500, 1113), F(125, 192), F(-2187, 6784), F(11, 84), 0]

_dop853 = [
    [],
    [0.0526001519587677318785587544488],
    [0.0197250569845378994544595329183, 0.0591751709536136983633785987549],
    [0.0295875854768068491816892993775, 0, 0.0887627564304205475450678981324],
    [0.241365134159266685502369798665, 0, -0.884549479328286085344864962717, 0.924834003261792003115737966543],
    [F(1, 27), 0, 0, 0.170828608729473871279604482173, 0.125467687566822425016691814123],
    [0.037109375, 0, 0, 0.170252211019544039314978060272, 0.0602165389804559606850219397283, -0.017578125],
    [
        *(0.0370920001185047927108779319836, 0, 0, 0.170383925712239993810214054705),
        *(0.107262030446373284651809199168, -0.0153194377486244017527936158236, 0.00827378916381402288758473766002),
    ],
    [
        *(0.624110958716075717114429577812, 0, 0, -3.36089262944694129406857109825),
        *(-0.868219346841726006818189891453, 27.5920996994467083049415600797, 20.1540675504778934086186788979),
        -43.4898841810699588477366255144,
    ],
    [
        *(0.477662536438264365890433908527, 0, 0, -2.48811461997166764192642586468),
        *(-0.590290826836842996371446475743, 21.2300514481811942347288949897, 15.2792336328824235832596922938),
        *(-33.2882109689848629194453265587, -0.0203312017085086261358222928593),
    ],
    [
        *(-0.93714243008598732571704021658, 0, 0, 5.18637242884406370830023853209),
        *(1.09143734899672957818500254654, -8.14978701074692612513997267357, -18.5200656599969598641566180701),
        *(22.7394870993505042818970056734, 2.49360555267965238987089396762, -3.0467644718982195003823669022),
    ],
    [
        *(2.27331014751653820792359768449, 0, 0, -10.5344954667372501984066689879),
        *(-2.00087205822486249909675718444, -17.9589318631187989172765950534, 27.9488845294199600508499808837),
        *(-2.85899827713502369474065508674, -8.87285693353062954433549289258, 12.3605671757943030647266201528),
        0.643392746015763530355970484046,
    ],
]
_dop853_result = [
    *(0.0542937341165687622380535766363, 0, 0, 0, 0, 4.45031289275240888144113950566),
    *(1.89151789931450038304281599044, -5.8012039600105847814672114227, 0.31116436695781989440891606237),
    *(-0.152160949662516078556178806805, 0.201365400804030348374776537501, 0.0447106157277725905176885569043),
]
_dop853_error = [
    *(0.01312004499419488073250102996, 0, 0, 0, 0, -1.225156446376204440720569753),
    *(-0.4957589496572501915214079952, 1.664377182454986536961530415, -0.350328848749973681688648729),
    *(0.3341791187130174790297318841, 0.08192320648511571246570742613, -0.02235530786388629525884427845),
]

EXPLICIT = Lazy(
    named(
        "euler",
        runge_kutta,
        [[]],
        [1],
        order=1,
        reference="L. Euler, Institutionum calculi integralis I (1768), section 650",
    ),
    named(
        "midpoint",
        runge_kutta,
        [[], [F(1, 2)]],
        [0, 1],
        order=2,
        reference="C. Runge, Über die numerische Auflösung von Differentialgleichungen, Math. Ann. 46 (1895)",
    ),
    named(
        "heun",
        runge_kutta,
        [[], [1]],
        [F(1, 2), F(1, 2)],
        order=2,
        reference="K. Heun, Neue Methode zur approximativen Integration der Differentialgleichungen, Z. Math. Phys. 45 (1900)",
    ),
    named("modified-euler", modified_euler),
    named(
        "rk3",
        runge_kutta,
        [[], [F(1, 2)], [-1, 2]],
        [F(1, 6), F(2, 3), F(1, 6)],
        order=3,
        reference="W. Kutta, Beitrag zur näherungsweisen Integration totaler Differentialgleichungen, "
        "Z. Math. Phys. 46 (1901)",
    ),
    named(
        "tvd-rk3",
        runge_kutta,
        [[], [1], [F(1, 4), F(1, 4)]],
        [F(1, 6), F(1, 6), F(2, 3)],
        order=3,
        reference="C.-W. Shu, S. Osher, Efficient implementation of essentially non-oscillatory shock-capturing schemes, "
        "J. Comput. Phys. 77 (1988)",
    ),
    named(
        "rk4",
        runge_kutta,
        [[], [F(1, 2)], [0, F(1, 2)], [0, 0, 1]],
        [F(1, 6), F(1, 3), F(1, 3), F(1, 6)],
        order=4,
        reference="W. Kutta, Beitrag zur näherungsweisen Integration totaler Differentialgleichungen, "
        "Z. Math. Phys. 46 (1901)",
    ),
    named(
        "bogacki-shampine",
        runge_kutta,
        [[], [F(1, 2)], [0, F(3, 4)], [F(2, 9), F(1, 3), F(4, 9), 0]],
        [F(2, 9), F(1, 3), F(4, 9), 0],
        b_embedded=[F(7, 24), F(1, 4), F(1, 3), F(1, 8)],
        order=3,
        reference="P. Bogacki, L. F. Shampine, A 3(2) pair of Runge-Kutta formulas, Appl. Math. Lett. 2 (1989)",
    ),
    named(
        "dormand-prince",
        runge_kutta,
        [
            [],
            [F(1, 5)],
            [F(3, 40), F(9, 40)],
            [F(44, 45), F(-56, 15), F(32, 9)],
            [F(19372, 6561), F(-25360, 2187), F(64448, 6561), F(-212, 729)],
            [F(9017, 3168), F(-355, 33), F(46732, 5247), F(49, 176), F(-5103, 18656)],
            _dormand_prince,
        ],
        _dormand_prince,
        b_embedded=[F(5179, 57600), 0, F(7571, 16695), F(393, 640), F(-92097, 339200), F(187, 2100), F(1, 40)],
        order=5,
        reference="J. R. Dormand, P. J. Prince, A family of embedded Runge-Kutta formulae, J. Comput. Appl. Math. 6 (1980)",
    ),
    named(
        "dop853",
        runge_kutta,
        _dop853,
        _dop853_result,
        b_embedded=[left - right for left, right in zip(_dop853_result, _dop853_error, strict=True)],
        order=8,
        reference="P. J. Prince, J. R. Dormand, High order embedded Runge-Kutta formulae, J. Comput. Appl. Math. 7 (1981); "
        "coefficients of DOP853: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, "
        "section II.5",
    ),
)
