// What is laid out once for all rollouts of one mesh, so that every sum over elements is a sum over a list: no two threads
// add to one number. sim_core/gpu/plan.py writes it; fields, order and types are the same there.
#pragma once

#include "record.hpp"

namespace thinshell {

struct Plan {
  // Unknowns, nodes of all rows of hinges, blocks of pairs of nodes, tile rows of the factor (tiles of 8 x 8), tiles of all its columns, and most tiles
  // that a column reaches down, the diagonal one included.
  int64_t unknowns, row_nodes, blocks, tiles, panel_tiles, reach;

  const int32_t *own;     // component (3 node + axis) of each unknown
  const int32_t *number;  // unknown of each component, -1: none (nodes, 3)

  // By nodes (nodes + 1): corners of triangles (3 t + a), of hinges (4 e + a), and samples of contact, with weights.
  const int32_t *triangle_start, *triangle_at, *hinge_start, *hinge_at, *sample_start, *sample_at;
  const double *sample_weight;
  const int32_t *sample_contact;  // contact of each sample

  // Rows of the Hessian of bending, of all hinges one after the other, by their nodes (row_nodes + 1): couplings, and
  // corners of the partners (4 e + a).
  const int32_t *row_start, *row_coupling, *row_corner;

  // Blocks (a, b), a eliminated after b, and what adds to each (blocks + 1): entries of the mass, corners of
  // hinges and places in their rows, samples of contact and products of weights; and parts (2 blocks + 1): blocks of
  // triangles, then of sides of hinges, six each of pairs of corners, triangles first (2 part + turned).
  const int32_t *block_node;  // (blocks, 2)
  const int32_t *mass_start, *mass_at;
  const int32_t *bend_start, *bend_corner, *bend_place;
  const int32_t *part_start, *part_at;
  const int32_t *contact_start, *contact_at;
  const double *contact_weight;

  // Blocks of nodes with prescribed components, by nodes (nodes + 1): which, and whether turned (2 block + turned).
  const int32_t *border_start, *border_at;

  // Factor: last tile row of each column, first column of each row, first tile of each column (tiles + 1); of each
  // tile row from its first column on, where entries of its tiles are among the blocks' values (behind these: zero, one), first
  // tile of each row (tiles + 1); values on the diagonal.
  const int32_t *last, *first, *panel_start, *entry_start, *entry, *diagonal;
};

}  // namespace thinshell
