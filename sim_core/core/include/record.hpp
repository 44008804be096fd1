// What a rollout is made of: flat arrays that the caller owns, in C order, and the switches of the search.
// sim_core/core/record.py writes it; fields, order and types are the same there.
#pragma once

#ifdef __CUDACC_RTC__
using int32_t = int;
using int64_t = long long;
using uint8_t = unsigned char;
#else
#include <cstdint>
#endif

namespace thinshell {

struct Record {
  // Sizes. `columns`: derivatives that are carried, padded to a multiple of `lanes` (lanes.hpp).
  int64_t nodes, triangles, hinges, couplings, tetrahedra, contacts, samples, corners, mounts, followers, bearing, columns;
  int64_t bodies, embedded, surfaces, surface_corners, edge_pairs, material_laws, bent, drags, loads, graded, shared, guides,
      yielding, couples;

  // Nodes: which components are prescribed (nodes, 3), rank of each in the elimination (nodes), where they are at rest. Where
  // mounts give way (yielding.hpp), what is prescribed and loads have rows for their deflections behind those of the nodes.
  const uint8_t *prescribed;
  const int32_t *rank;
  const double *rest;      // [m] (nodes, 3)
  const double *external;  // weight and dead loads [N] (nodes, 3)

  // Mass [kg], and what damps by mass, alpha M of the nodes that nothing holds [kg/s], of one sparse pattern.
  const int32_t *mass_start, *mass_column;
  const double *mass, *mass_damping;

  // Triangles: nodes (t, 3), gradients of the hat functions (t, 3, 2), area times stiffness (t, 9), damping [s] (t).
  const int32_t *triangle;
  const double *hats;
  double *stretch_stiffness;
  const double *stretch_damping;

  // Hinges: nodes (h, 4), angles at rest (h). Bending is a quadratic form in their angles: rows of couplings, with the
  // stiffness [N m] and the damping of it [N m s].
  const int32_t *hinge;
  const double *rest_angle;
  const int32_t *coupling_start, *coupling_column;
  double *bend_stiffness, *bend_damping;

  // Tetrahedra: nodes (t, 10), gradients of the shape functions at four points (t, 4, 10, 3), their volumes (t, 4) [m^3]
  // times the factor of the modulus; mu, K_own, K_mean [Pa] and damping [s] (t, 4).
  const int32_t *tetrahedron;
  const double *gel_gradient;
  double *gel_volume;
  const double *gel_number;

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

  // Laws that effects add to contacts, those of shapes, surfaces and edges one after the other (added_laws.hpp): first of
  // each contact (. + 1), up to what gap bonds last [m]; of each law its kind, the address of its function and where its
  // numbers begin (. + 1).
  const int32_t *added_start;
  const double *bond_reach;
  const int32_t *added_kind;
  const int64_t *added_function;
  const int32_t *added_number_start;
  const double *added_number;

  // Material laws that effects add to elements, and plastic flow (strain_laws.hpp): kind of the elements, how many numbers
  // a point sees and remembers, its functions, first point (. + 1) and first number of its rows (. + 1); of each point
  // the element and its area [m^2], or volume [m^3].
  const int32_t *material_kind, *material_inputs, *material_states;
  const int64_t *material_function;  // (., 5)
  const int32_t *material_start, *material_row_start, *material_element;
  double *material_area;
  const double *material_row;

  // Triangles that bend by such laws: hinges around each (. + 1), and what their angles make of curvatures (., 3).
  const int32_t *bent_start, *bent_hinge;
  const double *bent_weight;

  // Bodies whose stiffness changes in time (gradings.hpp): kind of the elements, first of them in the record, and how many
  // (. + 1), their places [m] (elements, 3); formulas of each (. + 1), their addresses, first numbers (. + 1) and numbers.
  // Elements that points of material laws are of, -1: of none. What such triangles add to couplings of hinges (shared).
  const int32_t *graded_kind, *graded_first, *graded_start;
  const double *graded_place;
  const int32_t *graded_map_start;
  const int64_t *graded_function;
  const int32_t *graded_number_start;
  const double *graded_number;
  const int32_t *material_graded;
  const int32_t *shared_element, *shared_coupling;
  const double *shared_stiffness, *shared_damping;

  // Triangles that air drags at: nodes (t, 3), rho C_D A [kg/m] (t).
  const int32_t *drag_triangle;
  const double *drag_factor;

  // Loads (loads.hpp): the table of each (loads + 1), times [s] and values; the load at the value 1, [N], [Pa], or a
  // pressure along normals (loads, 3); nodes of dead loads (loads + 1) with weights; faces under pressure (loads + 1) with
  // 3 or 6 nodes, else -1 (f, 6); rules of such faces.
  const int32_t *load_table_start;
  const double *load_time, *load_value, *load_number;
  const int32_t *dead_start, *dead_node;
  const double *dead_weight;
  const int32_t *face_start, *face_node;
  const double *rule_weight, *rule_shape, *rule_slope;

  // Affine bodies: control nodes (bodies, 4), gradients of their barycentric coordinates (bodies, 4, 3) [1/m], stiffness
  // [J]; nodes that are combinations of others: which (embedded), and of which with what weights (embedded + 1).
  const int32_t *body_control;
  const double *body_slope, *body_stiffness;
  const int32_t *embedded_node, *embedded_start, *embedded_in;
  const double *embedded_weight;

  // Guides of sliders: nodes of both bodies (guides, 8), what they have of the point and of the line (guides, 8, 2), stiffness
  // [N/m].
  const int32_t *guide_node;
  const double *guide_weight, *guide_stiffness;
  // Couples: the two nodes of each line (couples, 2), the axis (couples, 3), the moment [N m]
  const int32_t *couple_node;
  const double *couple_axis, *couple_moment;

  // Mounts that give way: which of them components of nodes follow (nodes, 3), -1: none; their springs [N/m] (yielding, 3).
  const int32_t *yield_of;
  const double *yield_spring;

  // Followers: node, mount, components that follow (f, 3), place in the mount's frame [m] (f, 3).
  const int32_t *follower_node, *follower_mount;
  const uint8_t *follower_axes;
  const double *follower_local;

  // Nodes of which derivatives of the loads are wanted.
  const int32_t *bearing_node;

  // Search.
  double step_tolerance, force_tolerance;
  int64_t fast_iterations, slow_iterations, second_order;

  // Derivatives of the numbers above, one block a column that has some: `*_of`: which column.
  int64_t stretch_blocks, bend_blocks, gel_blocks, mass_blocks;
  const int32_t *stretch_of, *bend_of, *gel_of, *mass_of;
  double *d_stretch_stiffness;                            // (., t, 9)
  const double *d_stretch_damping;                        // (., t)
  double *d_bend_stiffness, *d_bend_damping;              // (., couplings) each
  double *d_gel;        // (., t, 5) of the numbers, and of the logarithm of the factor
  const double *d_mass, *d_mass_damping;                  // (., entries) each
  const double *d_external;                               // (nodes, 3, columns)
  const double *d_law;                                    // (contacts, 8, columns)
  const double *d_surface_law, *d_edge_law;               // (., 8, columns) each
  const double *d_added_number;                           // (., columns)
  const double *d_drag_factor;                            // (t, columns)
  const double *d_load_number;                            // (loads, 3, columns)
  // Of rows of material laws, and of the logarithm of areas behind each: blocks of each law (. + 1), their columns, and
  // where they begin in `d_material_row`.
  const int32_t *material_block_start, *material_of, *material_block_row;
  double *d_material_row;
  const double *d_yield_spring;                           // (yielding, 3, columns)
  const double *d_graded_number;                          // (., columns)
  const double *d_shared_stiffness, *d_shared_damping;    // (bend_blocks, shared) each

  // Columns that are sums of others with weights that change: which is added to which (responses.hpp).
  int64_t modulations;
  const int32_t *modulated_from, *modulated_to;
};

// Why a search found no end of a step.
enum Failure : int64_t { iteration_limit, no_lower_energy, blocked, not_finite, not_factorised, turned_over };

// What was done in a step. `parts`: in how many it was made; `made`: how much of it, in shares of `finest` (rollout.hpp);
// `failure`: of the last search that failed.
struct StepCounts {
  int64_t iterations, factorisations, tries, residuals, contacts, tightest, parts, made, failure;
  double residual, update, gap;
};

}  // namespace thinshell
