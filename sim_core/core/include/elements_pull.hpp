// Elements on the way back: what their forces and memory pass on of their weights to where rates are measured from, what
// material laws remember, and the numbers. Forces by positions at the end are in the Hessian.
//
// With the weights y of the residual an element's work is s . (L y), L = de/dx its strains' derivatives (elements.hpp):
//
//     weights of e_b:    -B (L y) / tau,            passed on to the nodes by L^T at the start of the step
//     of a number p:     (L y) . [dK/dp e + dB/dp (e - e_b) / tau]
#pragma once
#pragma once

#include "loads_pull.hpp"
#include "sheet_pull.hpp"
#include "tetrahedra_pull.hpp"
