// What a rollout responds to in addition to parameters: parameters that change in time, and laws that it does not have.
//
// A column may be a sum of the columns of parameters, each times a weight that changes from step to step (`Modulations`),
// or stand for a law that the rollout lacks: what that law would change in the forces, evaluated with a memory of its own
// along the path that the rollout takes, is a source of the linearised steps (sim_core/gradients/frozen_path.py).
#pragma once

#include <algorithm>
#include <utility>
#include <vector>

#include "record.hpp"
#include "vectors.hpp"

namespace thinshell {

// Derivatives of a record's numbers in columns that are sums of others, with weights that change.
class Modulations {
 public:
  // The record's derivatives become copies that are kept here.
  explicit Modulations(Record &record) : r_(record) {
    if (!r_.modulations) return;
    const std::size_t entries = r_.mass_start[r_.nodes];
    own(r_.d_external, 3 * (r_.nodes + r_.yielding));
    own(r_.d_yield_spring, 3 * r_.yielding);
    own(r_.d_law, 8 * r_.contacts);
    own(r_.d_surface_law, 8 * r_.surfaces);
    own(r_.d_edge_law, 8 * r_.edge_pairs);
    own(r_.d_added_number, r_.added_number_start[r_.added_start[r_.contacts + r_.surfaces + r_.edge_pairs]]);
    own(r_.d_stretch_stiffness, r_.stretch_of, r_.stretch_blocks, 9 * r_.triangles);
    own(r_.d_stretch_damping, r_.stretch_of, r_.stretch_blocks, r_.triangles);
    own(r_.d_bend_stiffness, r_.bend_of, r_.bend_blocks, r_.couplings);
    own(r_.d_bend_damping, r_.bend_of, r_.bend_blocks, r_.couplings);
    own(r_.d_gel, r_.gel_of, r_.gel_blocks, 5 * r_.tetrahedra);
    const int64_t rows = r_.material_block_start[r_.material_laws];
    material_.assign(r_.d_material_row, r_.d_material_row + r_.material_block_row[rows]);
    r_.d_material_row = material_.data();
    own(r_.d_drag_factor, r_.drags);
    own(r_.d_mass, r_.mass_of, r_.mass_blocks, entries);
    own(r_.d_mass_damping, r_.mass_of, r_.mass_blocks, entries);
  }
  Modulations(const Modulations &) = delete;

  // `weights`: one a modulation.
  void apply(const double *weights) {
    if (!weights) return;
    for (auto &[values, rows] : dense_)
      for (std::size_t k = 0; k < rows; ++k) {
        double *row = &values[k * r_.columns];
        for (int m = 0; m < r_.modulations; ++m) row[r_.modulated_to[m]] = 0.0;
        for (int m = 0; m < r_.modulations; ++m) row[r_.modulated_to[m]] += weights[m] * row[r_.modulated_from[m]];
      }
    for (Stack &stack : stacks_) {
      for (int m = 0; m < r_.modulations; ++m)
        if (double *to = stack.block(r_.modulated_to[m])) std::fill_n(to, stack.size, 0.0);
      for (int m = 0; m < r_.modulations; ++m) {
        double *to = stack.block(r_.modulated_to[m]);
        const double *from = stack.block(r_.modulated_from[m]);
        for (std::size_t k = 0; to && from && k < stack.size; ++k) to[k] += weights[m] * from[k];
      }
    }
    for (int law = 0; law < r_.material_laws; ++law) {
      for (int m = 0; m < r_.modulations; ++m)
        if (const int to = block(law, r_.modulated_to[m]); to >= 0) std::fill_n(row(to), size(to), 0.0);
      for (int m = 0; m < r_.modulations; ++m) {
        const int to = block(law, r_.modulated_to[m]), from = block(law, r_.modulated_from[m]);
        for (int k = 0; to >= 0 && from >= 0 && k < size(to); ++k) row(to)[k] += weights[m] * row(from)[k];
      }
    }
  }

 private:
  // Blocks of some columns.
  struct Stack {
    std::vector<double> values;
    const int32_t *of;
    int64_t blocks;
    std::size_t size;
    double *block(int column) {
      const int32_t *at = std::find(of, of + blocks, column);
      return at == of + blocks ? nullptr : &values[size * (at - of)];
    }
  };

  // Of the rows of a material law: the block of a column, -1: none.
  int block(int law, int column) const {
    for (int b = r_.material_block_start[law]; b < r_.material_block_start[law + 1]; ++b)
      if (r_.material_of[b] == column) return b;
    return -1;
  }
  double *row(int block) { return &material_[r_.material_block_row[block]]; }
  int size(int block) const { return r_.material_block_row[block + 1] - r_.material_block_row[block]; }

  template <class Array> void own(Array &array, std::size_t rows) {
    dense_.emplace_back(std::vector<double>(array, array + rows * r_.columns), rows);
    array = dense_.back().first.data();
  }
  template <class Array> void own(Array &array, const int32_t *of, int64_t blocks, std::size_t size) {
    stacks_.push_back({std::vector<double>(array, array + blocks * size), of, blocks, size});
    array = stacks_.back().values.data();
  }

  Record &r_;
  std::vector<std::pair<std::vector<double>, std::size_t>> dense_;
  std::vector<Stack> stacks_;
  std::vector<double> material_;
};

// What laws that a rollout lacks add to the forces of a step, by columns, columns innermost: forces on the nodes [N],
// moments of contacts about their bodies [N m], and motions of mounts, in their frames [m, rad].
struct Sources {
  // A mount that gives way by `compliance` [m/N], along the world's axes, times the load on the `nodes` that it carries.
  struct Compliant {
    int column, mount;
    double compliance[3];
    std::vector<int32_t> nodes;
  };
  Values force, moment, motion;  // (nodes, 3, .), (contacts, 3, .), (mounts, 6, .); empty: none
  std::vector<Compliant> compliant;
  bool any() const { return !motion.empty(); }
};

}  // namespace thinshell
