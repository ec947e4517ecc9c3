"""Errata of the paper and differences of substance, each with the numbers that show it, computed on demand."""

# ruff: noqa: E501
from typing import NamedTuple

import jax
import numpy as np

from slippulse_jax import theory
from slippulse_jax.exact.bulk import exact_lengths, rebreaking_onset
from slippulse_jax.interface import Interface
from slippulse_jax.paper import FIG2
from slippulse_jax.slider import Slider


class Erratum(NamedTuple):
    """A misprint or an error of algebra; formulas in LaTeX."""

    where: str
    printed: str
    correct: str
    check: str


class Difference(NamedTuple):
    """A claim that the model does not bear out as worded."""

    claim: str
    found: str


def errata() -> list[Erratum]:
    """Compute the errata, at the parameters of Fig. 2."""
    with jax.enable_x64(True):
        right, k, k2 = theory.appendix(FIG2), FIG2.kappa, FIG2.kappa_2
        # Ψ_6(0) as printed, where the coefficient of e^{−(κ+κ_2)s} is the constant term again, and A_0 with it (cra51b)
        psi6 = k * (1 + k) / (2 * (k - k2)) - 2 * k * (k**2 + k2) / (k**2 - k2**2)
        wrong = right.A0 + FIG2.beta * right.U0 * right.psi2 * (psi6 - right.psi6_0) / (1 + k)
        # α_2 as the bracket is printed, ½[1 − (κ² − √D/κ_T²)], beside the one that solves cra08 and cra09
        printed_alpha = (1 - (FIG2.kappa**2 - FIG2.mode_splitting / FIG2.kappa_T**2)) / 2
        continuum = theory.continuum_stress(FIG2, 0.0)
        return [
            Erratum(
                where="below cra18",
                printed=r"$\alpha_m = \frac12[1 - (\kappa^2 \pm \sqrt{\mathcal D}/\kappa_T^2)]$",
                correct=r"$\frac12[1 - (\kappa^2 \pm \sqrt{\mathcal D})/\kappa_T^2]$",
                check=rf"$\alpha_2$: {float(printed_alpha):.2f} against {float(FIG2.alpha_2):.4f}, which is $1-\kappa_2^2/\kappa_T^2$ = {float(1 - (FIG2.kappa_2 / FIG2.kappa_T) ** 2):.4f}",
            ),
            Erratum(
                where="cra45b, cra45c",
                printed=r"$A_{40}+A_{30} = \frac12\beta U\kappa/(\kappa+\kappa_2)$",
                correct="without the ½",
                check=f"cra45d1 and cra45d2 follow only without it; $u(0) = u_s$ at $U_0$ = {float(right.U0):.4f}",
            ),
            Erratum(
                where="cra54, cra54b",
                printed=r"$-\kappa(\lambda_c\kappa^2+\kappa_2)/(\kappa^2-\kappa_2^2)$ in front of $e^{-(\kappa+\kappa_2)s}$",
                correct=r"$\frac12\kappa(1-\lambda_c\kappa)/(\kappa+\kappa_2)\,(1/\Psi_2-1)$",
                check=f"$A_0$ = {float(wrong):.3f} printed: at these parameters the front could not start; {float(right.A0):.4f} corrected; {float(continuum):.4f} self-consistent",
            ),
        ]


def differences() -> list[Difference]:
    """Compute the differences of substance."""
    length = float(exact_lengths(FIG2))
    stiffness = np.geomspace(1e-3, 1, 600)
    peaks = [stiffness[np.argmax(exact_lengths(Slider(height, stiffness, 0.3)))] for height in (10.0, 25.0, 50.0)]
    sloped = exact_lengths(FIG2, interface=Interface(threshold_slope=np.array([-1e-3, 0, 1e-3, 1e-2])))
    stressed = exact_lengths(FIG2, interface=Interface(prestress=np.array([0.4, 0.5, 0.6])))
    tall, soft = Slider(75_000.0, 1 / (2.6 * 75_000), 0.3), Slider(6.84029016, 3.56033954e-03, 0.297661153)
    tall_length = float(exact_lengths(tall))
    soft_length = float(exact_lengths(soft, interface=Interface(0.6085)))
    with jax.enable_x64(True):
        formulas = {
            "self-consistent continuum": theory.length_continuum(FIG2),
            "frozen continuum": theory.length_frozen(FIG2),
            "Eq. (58)": theory.length(FIG2),
            "Eq. (25)": theory.length_eq25(FIG2),
        }
        macroscopic, tall_eq25 = theory.macroscopic_length(1.0, 0.3), theory.length_eq25(tall)
        critical, soft_critical = (float(theory.runaway_prestress(slider)) for slider in (FIG2, soft))
        return [
            Difference(
                "Eq. (58) and Eq. (25) agree with the numerics",
                f"exact lattice {length:.3f} ({int(np.ceil(length))} contacts), {', '.join(f'{name} {float(x):.3f}' for name, x in formulas.items())}: neglecting discreteness lengthens the front, freezing the slider shortens it, and the two nearly cancel",
            ),
            Difference(
                "Eq. (25) holds for tall sliders",
                rf"at $b = 1$ and $H/\lambda_c = 75\,000$: lattice $\Lambda/H$ = {tall_length / 75_000:.4f}, macroscopic law {float(macroscopic):.4f}, Eq. (25) {float(tall_eq25) / 75_000:.4f}: it freezes the upper layer",
            ),
            Difference(
                r"$\Lambda$ grows with $k/K$",
                rf"it peaks at $k/K$ = {', '.join(f'{x:.3f}' for x in peaks)} for $H/\lambda_c$ = 10, 25, 50 and falls beyond",
            ),
            Difference(
                "the first precursor is one front",
                rf"up to $b = (k/\lambda_c^2)H/G$ = {', '.join(f'{x:.2f}' for x in rebreaking_onset([10, 25, 100, 1e4], 0.3))} at $H/\lambda_c$ = 10, 25, 100, 10⁴ and {theory.rebreaking_b():.4f} for $\lambda_c \to 0$; beyond, contact 0 is back at its threshold before the front stops, breaks again, and the event goes farther than its first front ([The macroscopic limit](theory.md#where-the-contact-at-the-edge-breaks-again))",
            ),
            Difference(
                r"$\Lambda(\epsilon) \approx \Lambda(0)(1-\epsilon)$",
                rf"with $\sigma_s(i) = \sigma_{{s0}}(1+\epsilon i)$, $\epsilon$ = −0.001, 0, 0.001, 0.01: {', '.join(f'{x:.2f}' for x in sloped)}; the relative change is far larger than $\epsilon$ per contact",
            ),
            Difference(
                "beyond a Griffith threshold the front never stops",
                rf"$\varphi_c = (1+G_{{00}})/2$ = {critical:.4f}; at $\varphi$ = 0.4, 0.5, 0.6: {', '.join(str(round(float(x), 2)) for x in stressed)}",
            ),
            Difference(
                "… for every slider",
                rf"no: at $(6.84, 0.00356, 0.298)$, $\varphi$ = 0.6085 exceeds $\varphi_c$ = {soft_critical:.4f} and the front still stops after {int(np.ceil(soft_length))} contacts, because a soft interface lets the stress fall below the threshold near the edge, before it recovers: $\varphi \ge \varphi_c$ is necessary, not sufficient",
            ),
        ]


def page() -> str:
    """Write the page of errata and differences, as Markdown."""
    return f"""# Errata of the paper, and where this project differs

This page lists the paper's misprints, and claims that the model does not bear out. It is for readers who use its equations.

Every number on this page is computed by `docs/tools/errata.py`; a test compares the page with it. Labels are those of the
paper's LaTeX source. Parameters, unless stated otherwise: Fig. 2, $H/\\lambda_c = 25$, $k/K = 0.03$, $\\nu = 0.3$.

## Errata

| Where | Printed | Correct | Check |
|---|---|---|---|
{_rows(errata())}

The Appendix also writes $\\sigma$ for Poisson's ratio and $a$ for $\\lambda_c$. None of these errors affects Eq. (25).
`tests/theory/test_theory.py` integrates the frozen equations (cra08–cra27) directly, without any $\\Psi$ or $A$, and finds the
corrected forms.

## Differences of substance

| Claim | Found |
|---|---|
{_rows(differences())}
"""


def _rows(table: list[Erratum] | list[Difference]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in table)
