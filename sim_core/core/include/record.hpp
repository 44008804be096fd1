// What a rollout is made of: flat arrays that the caller owns, in C order, and the switches of the search.
// sim_core/core/record.py writes it; fields, order and types are the same there.
#pragma once

#include <cstdint>

namespace thinshell {

struct Record {
  // Sizes. `columns`: derivatives that are carried, padded to a multiple of `lanes` (columns.hpp).
  int64_t nodes, triangles, hinges, couplings, tetrahedra, contacts, samples, corners, mounts, followers, bearing, columns;
  int64_t surfaces, surface_corners, edge_pairs;

  // Nodes: which components are prescribed (nodes, 3), rank of each in the elimination (nodes), where they are at rest.
  const uint8_t *prescribed;
  const int32_t *rank;
  const double *rest;      // [m] (nodes, 3)
  const double *external;  // weight and dead loads [N] (nodes, 3)

  // Mass [kg], and what damps by mass, alpha M of the nodes that nothing holds [kg/s], of one sparse pattern.
  const int32_t *mass_start, *mass_column;
  const double *mass, *mass_damping;

  // Triangles: nodes (t, 3), gradients of the hat functions (t, 3, 2), area times stiffness (t, 9), damping [s] (t).
  const int32_t *triangle;
  const double *hats, *stretch_stiffness, *stretch_damping;

  // Hinges: nodes (h, 4), angles at rest (h). Bending is a quadratic form in their angles: rows of couplings, with the
  // stiffness [N m] and the damping of it [N m s].
  const int32_t *hinge;
  const double *rest_angle;
  const int32_t *coupling_start, *coupling_column;
  const double *bend_stiffness, *bend_damping;

  // Tetrahedra: nodes (t, 10), gradients of the shape functions at four points (t, 4, 10, 3), their volumes (t, 4) [m^3]
  // times the factor of the modulus; mu, K_own, K_mean [Pa] and damping [s] (t, 4).
  const int32_t *tetrahedron;
  const double *gel_gradient, *gel_volume, *gel_number;

  // Contacts with rigid shapes: samples of each (contacts + 1), the body's node and mount, its rotation in the mount
  // (contacts, 9), the law (contacts, 8), the shape (contacts, 5); samples: nodes (s, corners), weights, areas [m^2].
  const int32_t *sample_start, *body_node, *body_mount;
  const double *body_rotation, *law, *shape;
  const int32_t *sample_node;
  const double *sample_weight, *sample_area;

  // Contacts of surfaces: samples and triangles of each (surfaces + 1), how much wider than a step needs partners are
  // looked for [m], the law (surfaces, 8); samples: nodes (s, surface_corners), how many count, weights, areas [m^2];
  // triangles: nodes (t, 3), and which corners and edges 01, 12, 20 are on a free border (t, 6).
  const int32_t *surface_sample_start, *surface_triangle_start;
  const double *surface_margin, *surface_law;
  const int32_t *surface_node, *surface_used;
  const double *surface_weight, *surface_area;
  const int32_t *surface_triangle, *surface_border;

  // Contacts of edges: first of our edges and of theirs (2 edge_pairs + 1), whether both are the same, margin, law; edges:
  // nodes (e, 2), areas [m^2], negative where it is ours that counts, and squared lengths at rest [m^2].
  const int32_t *edge_start, *edge_once;
  const double *edge_margin, *edge_law;
  const int32_t *edge_node;
  const double *edge_area, *edge_square;

  // Followers: node, mount, components that follow (f, 3), place in the mount's frame [m] (f, 3).
  const int32_t *follower_node, *follower_mount;
  const uint8_t *follower_axes;
  const double *follower_local;

  // Nodes of which derivatives of the loads are wanted.
  const int32_t *bearing_node;

  // Search.
  double step_tolerance, force_tolerance;
  int64_t fast_iterations, second_order;

  // Derivatives of the numbers above, one block a column that has some: `*_of`: which column.
  int64_t stretch_blocks, bend_blocks, gel_blocks, mass_blocks;
  const int32_t *stretch_of, *bend_of, *gel_of, *mass_of;
  const double *d_stretch_stiffness, *d_stretch_damping;  // (., t, 9), (., t)
  const double *d_bend_stiffness, *d_bend_damping;        // (., couplings) each
  const double *d_gel;  // (., t, 5) of the numbers, and of the logarithm of the factor
  const double *d_mass, *d_mass_damping;                  // (., entries) each
  const double *d_external;                               // (nodes, 3, columns)
  const double *d_law;                                    // (contacts, 8, columns)
  const double *d_surface_law, *d_edge_law;               // (., 8, columns) each
};

// What was done in a step. `failed`: the search gave up, and the state is as it was.
struct StepCounts {
  int64_t iterations, factorisations, tries, residuals, contacts, tightest;
  double residual, update, gap;
};

}  // namespace thinshell
