// Stiffness that changes in time: factors of elements that are formulas of their place and of the time at which a step
// starts (sim_core/energies/grading.py),
//
//     E_element = f(X, t) E_uniform
//
// each compiled by itself with its derivatives by all arguments (sim_core/core/pointwise.py) and called by its address.
// The record has the stiffness at t = 0; before a step all that is proportional to it is brought up to date, and so is
// what derivatives know of it: with d log f / dp = l and the record's K and dK/dp, without l,
//
//     f / f_0 K,    f / f_0 (dK/dp + l K)
#pragma once

#include <vector>

#include "added_laws.hpp"
#include "record.hpp"
#include "strain_laws.hpp"

namespace thinshell {

class Gradings {
 public:
  // `columns`: of the derivatives of the record.
  Gradings(const Record &record, int64_t columns) : r_(record), width_(int(columns)) {
    if (!any()) return;
    const int64_t points = r_.material_start[r_.material_laws], blocks = r_.material_block_start[r_.material_laws];
    stretch_ = copied(r_.stretch_stiffness, 9 * r_.triangles);
    d_stretch_ = copied(r_.d_stretch_stiffness, 9 * r_.triangles * r_.stretch_blocks);
    bend_ = copied(r_.bend_stiffness, r_.couplings);
    bend_damping_ = copied(r_.bend_damping, r_.couplings);
    d_bend_ = copied(r_.d_bend_stiffness, r_.couplings * r_.bend_blocks);
    d_bend_damping_ = copied(r_.d_bend_damping, r_.couplings * r_.bend_blocks);
    volume_ = copied(r_.gel_volume, points_of_gels * r_.tetrahedra);
    d_gel_ = copied(r_.d_gel, numbers_of_gels * r_.tetrahedra * r_.gel_blocks);
    area_ = copied(r_.material_area, points);
    d_row_ = copied(r_.d_material_row, r_.material_block_row[blocks]);
    measure(0.0);
    first_ = factor_;
  }

  bool any() const { return r_.graded > 0; }

  // The factor of an element of some kind now over that of the record.
  double growth(int kind, int element) const {
    for (int p = 0; p < r_.graded; ++p) {
      const int own = element - r_.graded_first[p];
      if (r_.graded_kind[p] == kind && own >= 0 && own < r_.graded_start[p + 1] - r_.graded_start[p])
        return ratio(r_.graded_start[p] + own);
    }
    return 1.0;
  }
  // The same by its number among all that change.
  double growth(int graded) const { return ratio(graded); }

  // Be at a time [s]; false where nothing changed since the last one.
  bool apply(double time) {
    if (!any() || time == time_) return false;
    time_ = time;
    measure(time);
    for (int p = 0; p < r_.graded; ++p)
      for (int g = r_.graded_start[p]; g < r_.graded_start[p + 1]; ++g) {
        const std::size_t e = r_.graded_first[p] + g - r_.graded_start[p];
        if (r_.graded_kind[p] == int(Strained::MEMBRANE)) stretch(g, e);
        if (r_.graded_kind[p] == int(Strained::SOLID)) fill(g, e);
      }
    bend();
    scale_laws();
    return true;
  }

 private:
  static constexpr int points_of_gels = 4, numbers_of_gels = 5, places = 4;  // x, y, z, t

  static std::vector<double> copied(const double *from, std::size_t size) { return {from, from + size}; }

  // Factors of all elements, and the derivatives of their logarithms (elements, columns).
  void measure(double time) {
    const int width = width_, count = r_.graded_start[r_.graded];
    factor_.assign(count, 1.0);
    grown_.assign(std::size_t(count) * width, 0.0);
    for (int p = 0; p < r_.graded; ++p)
      for (int m = r_.graded_map_start[p]; m < r_.graded_map_start[p + 1]; ++m) {
        const int begin = r_.graded_start[p], n = r_.graded_start[p + 1] - begin;
        const int numbers = r_.graded_number_start[m + 1] - r_.graded_number_start[m], k = places + numbers;
        row_.resize(std::size_t(2 * k + 1) * n);
        for (int e = 0; e < n; ++e) {
          for (int i = 0; i < 3; ++i) row_[std::size_t(i) * n + e] = r_.graded_place[3 * (begin + e) + i];
          row_[std::size_t(3) * n + e] = time;
          for (int i = 0; i < numbers; ++i)
            row_[std::size_t(places + i) * n + e] = r_.graded_number[r_.graded_number_start[m] + i];
        }
        reinterpret_cast<LawFunction>(r_.graded_function[m])(n, row_.data());
        for (int e = 0; e < n; ++e) {
          const double value = row_[std::size_t(k) * n + e];
          factor_[begin + e] *= value;
          for (int i = 0; i < numbers; ++i) {
            const double by = row_[std::size_t(k + 1 + places + i) * n + e] / value;
            const double *slope = r_.d_graded_number + std::size_t(r_.graded_number_start[m] + i) * width;
            for (int c = 0; c < width; ++c) grown_[std::size_t(begin + e) * width + c] += by * slope[c];
          }
        }
      }
  }
  double ratio(int g) const { return factor_[g] / first_[g]; }
  double grown(int g, int column) const { return grown_[std::size_t(g) * width_ + column]; }

  void stretch(int g, std::size_t t) {
    for (std::size_t k = 9 * t; k < 9 * t + 9; ++k) r_.stretch_stiffness[k] = ratio(g) * stretch_[k];
    for (int m = 0; m < r_.stretch_blocks; ++m)
      for (std::size_t k = 9 * t; k < 9 * t + 9; ++k) {
        const std::size_t at = std::size_t(9) * r_.triangles * m + k;
        r_.d_stretch_stiffness[at] = ratio(g) * (d_stretch_[at] + grown(g, r_.stretch_of[m]) * stretch_[k]);
      }
  }
  void fill(int g, std::size_t t) {
    for (std::size_t k = points_of_gels * t; k < points_of_gels * (t + 1); ++k) r_.gel_volume[k] = ratio(g) * volume_[k];
    for (int m = 0; m < r_.gel_blocks; ++m) {
      const std::size_t at = numbers_of_gels * (r_.tetrahedra * m + t) + numbers_of_gels - 1;
      r_.d_gel[at] = d_gel_[at] + grown(g, r_.gel_of[m]);
    }
  }
  void bend() {
    if (!r_.shared) return;
    std::copy(bend_.begin(), bend_.end(), r_.bend_stiffness);
    std::copy(bend_damping_.begin(), bend_damping_.end(), r_.bend_damping);
    std::copy(d_bend_.begin(), d_bend_.end(), r_.d_bend_stiffness);
    std::copy(d_bend_damping_.begin(), d_bend_damping_.end(), r_.d_bend_damping);
    for (int64_t s = 0; s < r_.shared; ++s) {
      const int g = r_.shared_element[s], k = r_.shared_coupling[s];
      r_.bend_stiffness[k] += (ratio(g) - 1.0) * r_.shared_stiffness[s];
      r_.bend_damping[k] += (ratio(g) - 1.0) * r_.shared_damping[s];
      for (int m = 0; m < r_.bend_blocks; ++m) {
        const double more = ratio(g) * grown(g, r_.bend_of[m]);
        const std::size_t from = r_.shared * m + s, to = r_.couplings * m + k;
        r_.d_bend_stiffness[to] += (ratio(g) - 1.0) * r_.d_shared_stiffness[from] + more * r_.shared_stiffness[s];
        r_.d_bend_damping[to] += (ratio(g) - 1.0) * r_.d_shared_damping[from] + more * r_.shared_damping[s];
      }
    }
  }
  // Areas of material laws, and of their rows the last entry.
  void scale_laws() {
    for (int law = 0; law < r_.material_laws; ++law)
      for (int i = r_.material_start[law]; i < r_.material_start[law + 1]; ++i) {
        const int g = r_.material_graded[i];
        if (g < 0) continue;
        r_.material_area[i] = ratio(g) * area_[i];
        for (int b = r_.material_block_start[law]; b < r_.material_block_start[law + 1]; ++b) {
          const int last = (r_.material_inputs[law] + 1) * (i - r_.material_start[law] + 1) - 1;
          const int at = r_.material_block_row[b] + last;
          r_.d_material_row[at] = d_row_[at] + grown(g, r_.material_of[b]);
        }
      }
  }

  const Record &r_;
  int width_;
  double time_ = -1.0;
  std::vector<double> first_, factor_, grown_, row_;
  std::vector<double> stretch_, d_stretch_, bend_, bend_damping_, d_bend_, d_bend_damping_, volume_, d_gel_, area_, d_row_;
};

}  // namespace thinshell
