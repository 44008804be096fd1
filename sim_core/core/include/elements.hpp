// Elements of sheets: triangles that stretch and hinges that bend, with damping by the rates of both (Kelvin-Voigt).
//
// Both are quadratic in a strain e(x), with stiffness K and damping B, over the time tau of a rate:
//
//     E = 1/2 e^T K e + 1/(2 tau) (e - e_b)^T B (e - e_b),    e_b = now e(x_start) + before e(x_past)
//     dE/dx = L^T s,   s = K e + B (e - e_b) / tau,   L = de/dx,    d2E/dx2 = L^T (K + B / tau) L + s . d2e/dx2
//
// Of triangles e is the Green strain, K = A h C and B = beta K (sim_core/energies/membrane.py); of hinges the change of
// all angles from rest, and K = sum_T A_T B_T^T D_T B_T with the curvature operator B_T, which couples them
// (sim_core/energies/curvature.py). An element adds its force, its Hessian, and, for derivatives by parameters p, what
// its force changes by where positions at the end are held:
//
//     L^T [dK/dp e + dB/dp (e - e_b) / tau - B de_b/dp / tau]
//
// Material laws of effects, and plastic flow, add to s and to its tangent (strain_laws.hpp).
#pragma once

#include <limits>
#include <vector>

#include "blocks.hpp"
#include "pack.hpp"
#include "record.hpp"
#include "sheet_point.hpp"
#include "strain_laws.hpp"

namespace thinshell {

// From what rates are measured: weights of the start of the step and of that before it, and the time; how long it is.
struct Rates {
  double now, before, tau, dt;
};

}  // namespace thinshell
