"""The material of the rod in every step: stiffness of its sections, forces of its muscles and damping, in PyElastica's arrays.

PyElastica's rod is linear and of constant volume: it divides forces by the stretch and couples by its cube. The network is neither, so
stiffness is multiplied by these, and muscles and damping act as strains of rest. Plain functions, which `rod_world` compiles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class RodArrays(NamedTuple):
    """Arrays of a PyElastica rod with e elements and e - 1 inner nodes, all changed in place there or here.

    Attributes:
        sigma: shears and elongation of the elements, (3, e).
        kappa: curvatures and twist at the inner nodes, (3, e - 1) in 1/m.
        dilatation: stretch of the elements, (e,).
        voronoi_dilatation: stretch at the inner nodes, (e - 1,).
        shear_matrix, bend_matrix: stiffness, (3, 3, e) in N and (3, 3, e - 1) in N m².
        rest_sigma, rest_kappa: strains without force, as `sigma` and `kappa`.
        inertia, inverse_inertia: rotary inertia of the elements, (3, 3, e) in kg m² and its inverse.
    """

    sigma: np.ndarray
    kappa: np.ndarray
    dilatation: np.ndarray
    voronoi_dilatation: np.ndarray
    shear_matrix: np.ndarray
    bend_matrix: np.ndarray
    rest_sigma: np.ndarray
    rest_kappa: np.ndarray
    inertia: np.ndarray
    inverse_inertia: np.ndarray


class Material(NamedTuple):
    """Properties of the rod.

    Attributes:
        stiffness, third: see `rod_section.SectionLaw`.
        share: of the stiffness that each element has, (e,).
        curvature: without force, (3,) in 1/m.
        inertia: rotary inertia of an element at rest, (3,) in kg m².
        places: of the muscles in a section, (actuators, 2) in m.
        module: of each element, (e,).
        chord: a twelfth of the squared distance of two rings in m², between which muscles are straight.
        cubic: force of a muscle over the cube of its elongation in N.
        base: stiffness of the first inner node over that of others.
        damping: time constant of the damping over the time step.
    """

    stiffness: np.ndarray
    third: np.ndarray
    share: np.ndarray
    curvature: np.ndarray
    inertia: np.ndarray
    places: np.ndarray
    module: np.ndarray
    chord: float
    cubic: float
    base: float
    damping: float


def find_active_stress(rod: RodArrays, material: Material, force: np.ndarray, active: np.ndarray) -> None:
    """Force and couple in the elements that is not linear in their strains: of muscles, and of the third order of the energy.

    Args:
        rod: with its strains.
        material: of the rod.
        force: with which muscles push their ends apart, (modules, actuators) in N.
        active: force and couple in the section's frame, written here, (6, e) in N and N m.
    """
    last = rod.kappa.shape[1] - 1
    strain = np.empty(6)
    for m in range(rod.sigma.shape[1]):
        before, after = max(m - 1, 0), min(m, last)
        for i in range(3):
            strain[i] = rod.sigma[i, m]
            strain[3 + i] = rod.kappa[i, after] if m <= 1 else 0.5 * (rod.kappa[i, before] + rod.kappa[i, after])
            active[i, m] = active[3 + i, m] = 0.0
        for j in range(material.places.shape[0]):
            x, y = material.places[j]
            along_x, along_y = strain[0] - strain[5] * y, strain[1] + strain[5] * x
            along_z = 1.0 + strain[2] + strain[3] * y - strain[4] * x
            stretch = np.sqrt(along_x**2 + along_y**2 + along_z**2)
            pull = (force[material.module[m], j] - material.cubic * (stretch - 1.0) ** 3) / stretch
            bend = pull * material.chord * along_z
            active[0, m] += pull * along_x
            active[1, m] += pull * along_y
            active[2, m] += pull * along_z - 0.5 * pull * material.chord * (strain[3] ** 2 + strain[4] ** 2)
            active[3, m] += y * pull * along_z - bend * strain[3]
            active[4, m] -= x * pull * along_z + bend * strain[4]
            active[5, m] += pull * (x * along_y - y * along_x)
        strain[2] = 0.0  # stiffness is a function of the elongation itself
        for i in range(6):
            for j in range(6):
                for k in range(6):
                    active[i, m] -= 0.5 * material.third[i, j, k] * strain[j] * strain[k]


def set_element_law(rod: RodArrays, material: Material, active: np.ndarray, last: np.ndarray) -> None:
    """Set stiffness, strain of rest and inertia of the elements.

    Args:
        rod: changed in place.
        material: of the rod.
        active: see `find_active_stress`.
        last: strains of the elements a step ago, those of now afterwards, (3, e).
    """
    for m in range(rod.sigma.shape[1]):
        for i in range(3):
            stiffness = 0.0
            for power in material.stiffness[1 if i == 2 else 0]:
                stiffness = stiffness * rod.sigma[2, m] + power
            stiffness *= material.share[m]
            rod.shear_matrix[i, i, m] = stiffness * rod.dilatation[m]
            rod.rest_sigma[i, m] = active[i, m] / stiffness - material.damping * (rod.sigma[i, m] - last[i, m])
            last[i, m] = rod.sigma[i, m]
            rod.inertia[i, i, m] = material.inertia[i] * rod.dilatation[m]
            rod.inverse_inertia[i, i, m] = 1.0 / rod.inertia[i, i, m]


def set_node_law(rod: RodArrays, material: Material, active: np.ndarray, last: np.ndarray) -> None:
    """Set stiffness and curvature of rest at the inner nodes; the first one is the base, of which only the upper half bends.

    Args:
        rod: changed in place.
        material: of the rod.
        active: see `find_active_stress`.
        last: curvatures a step ago, those of now afterwards, (3, e - 1).
    """
    for k in range(rod.kappa.shape[1]):
        below = 1 if k == 0 else k
        elongation = 0.5 * (rod.sigma[2, below] + rod.sigma[2, k + 1])
        share = 0.5 * (material.share[below] + material.share[k + 1]) * (material.base if k == 0 else 1.0)
        for i in range(3):
            stiffness = 0.0
            for power in material.stiffness[3 if i == 2 else 2]:
                stiffness = stiffness * elongation + power
            stiffness *= share
            couple = 0.5 * (active[3 + i, below] + active[3 + i, k + 1])
            rod.bend_matrix[i, i, k] = stiffness * rod.voronoi_dilatation[k] ** 3
            rod.rest_kappa[i, k] = material.curvature[i] + couple / stiffness - material.damping * (rod.kappa[i, k] - last[i, k])
            last[i, k] = rod.kappa[i, k]
