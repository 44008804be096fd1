// Material laws of effects, and plastic flow, on the elements of one kind: what they add to stress and tangent, and what
// they remember (sim_core/energies/strain_law.py).
//
// With the strain e at the end of a step, e_0 at its start and the internal variables z, a law adds the energy
//
//     sum_T A_T w(e_T; e_0, z),    stress A dw/de,    tangent A d2w/de2,    and leaves z'(e; e_0, z)
//
// Each is compiled by itself with its derivatives (material_point.hpp) and called by its address for all points at once.
// A row has what a point sees: e, e_0 (K each), the stiffness D (K, K), z, the length of the step, numbers.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "lanes.hpp"
#include "record.hpp"
#include "small.hpp"

namespace thinshell {

using StressFunction = void (*)(long n, const double *in, double *out);
using PushFunction = void (*)(long n, const double *in, const double *change, double *out);

// The nearest positive semidefinite matrix to a symmetric one, in place, by Jacobi rotations.
template <int N> void make_semidefinite(double *m) {
  double v[N * N] = {};
  for (int i = 0; i < N; ++i) v[N * i + i] = 1.0;
  double size = 0.0;
  for (int k = 0; k < N * N; ++k) size = std::max(size, std::abs(m[k]));
  for (int sweep = 0; sweep < 30; ++sweep) {
    double off = 0.0;
    for (int p = 0; p < N; ++p)
      for (int q = p + 1; q < N; ++q) {
        off = std::max(off, std::abs(m[N * p + q]));
        if (m[N * p + q] == 0.0) continue;
        const double theta = 0.5 * (m[N * q + q] - m[N * p + p]) / m[N * p + q];
        const double t = (theta < 0.0 ? -1.0 : 1.0) / (std::abs(theta) + std::sqrt(theta * theta + 1.0));
        const double c = 1.0 / std::sqrt(t * t + 1.0), s = t * c;
        auto turn = [&](double &a, double &b) {
          const double first = c * a - s * b;
          b = s * a + c * b;
          a = first;
        };
        for (int k = 0; k < N; ++k) turn(m[N * k + p], m[N * k + q]);
        for (int k = 0; k < N; ++k) turn(m[N * p + k], m[N * q + k]);
        for (int k = 0; k < N; ++k) turn(v[N * k + p], v[N * k + q]);
      }
    if (off <= 1e-15 * size) break;
  }
  double values[N];
  for (int k = 0; k < N; ++k) values[k] = std::max(m[N * k + k], 0.0);
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j) {
      m[N * i + j] = 0.0;
      for (int k = 0; k < N; ++k) m[N * i + j] += v[N * i + k] * values[k] * v[N * j + k];
    }
}

// Kinds of elements (KINDS of sim_core/core/materials.py).
enum class Strained { MEMBRANE, BENDING, SOLID };

template <int K> class StrainLaws {
 public:
  StrainLaws(const Record &record, Strained kind, int elements) : r_(record), width_(int(record.columns)) {
    for (int k = 0; k < r_.material_laws; ++k)
      if (r_.material_kind[k] == int(kind)) laws_.emplace_back(r_, k);
    if (!any()) return;
    stress_.assign(std::size_t(K) * elements, 0.0);
    tangent_.assign(std::size_t(K) * K * elements, 0.0);
    before_.assign(stress_.size() * width_, 0.0);
  }

  bool any() const { return !laws_.empty(); }

  // In all that follows `strain(element, e)` writes the strains of an element at the end of a step; here at its start.
  template <class F> void begin(F &&strain, double dt) {
    for (Law &law : laws_)
      for (int p = 0; p < law.count; ++p) {
        strain(law.element[p], law.row(p) + K);
        std::copy_n(&law.state[std::size_t(law.states) * p], law.states, law.row(p) + law.first_state());
        law.row(p)[law.first_state() + law.states] = dt;
      }
  }

  template <class F> double energy(F &&strain) {
    double out = 0.0;
    for (Law &law : laws_) {
      law.see(strain);
      law.exert();
      for (int p = 0; p < law.count; ++p) out += law.area[p] * law.out[(1 + K) * p];
    }
    return out;
  }

  // Stresses times areas (elements, K).
  template <class F> const double *stress(F &&strain) {
    std::fill(stress_.begin(), stress_.end(), 0.0);
    for (Law &law : laws_) {
      law.see(strain);
      law.exert();
      for (int p = 0; p < law.count; ++p)
        for (int i = 0; i < K; ++i) stress_[K * law.element[p] + i] += law.area[p] * law.out[(1 + K) * p + 1 + i];
    }
    return stress_.data();
  }

  // Both times areas; returns the tangents (elements, K, K), the stresses are in `stresses`. Without `exact` no law
  // softens by more than the stiffness D that it sees where `with_own`, or at all.
  template <class F> const double *tangent(F &&strain, bool exact, bool with_own) {
    std::fill(stress_.begin(), stress_.end(), 0.0);
    std::fill(tangent_.begin(), tangent_.end(), 0.0);
    for (Law &law : laws_) {
      law.see(strain);
      law.respond();
      constexpr int each = 1 + K + K * K;
      for (int p = 0; p < law.count; ++p) {
        double *found = &law.out[std::size_t(each) * p], *t = found + 1 + K;
        const double *own = law.row(p) + 2 * K;
        if (!exact) {
          for (int k = 0; with_own && k < K * K; ++k) t[k] += own[k];
          make_semidefinite<K>(t);
          for (int k = 0; with_own && k < K * K; ++k) t[k] -= own[k];
        }
        for (int i = 0; i < K; ++i) stress_[K * law.element[p] + i] += law.area[p] * found[1 + i];
        for (int k = 0; k < K * K; ++k) tangent_[K * K * law.element[p] + k] += law.area[p] * t[k];
      }
    }
    return tangent_.data();
  }
  const double *stresses() const { return stress_.data(); }

  // Internal variables after the step.
  template <class F> void end(F &&strain) {
    for (Law &law : laws_) {
      if (!law.states) continue;
      law.see(strain);
      law.remember();
    }
  }

  // Changes of stresses times areas where strains at the end are held, into (elements, K, columns).
  template <class F> void add_columns(F &&strain, double *out) {
    for (Law &law : laws_) {
      law.see(strain);
      law.exert();
      for (int first = 0; first < width_; first += lanes) {
        law.change(nullptr, before_.data(), first);
        law.push_stress();
        for (int p = 0; p < law.count; ++p) {
          const double *moved = law.pushed(p), *stress = &law.out[(1 + K) * p + 1];
          const double *grown = &law.moved[std::size_t(p) * law.changes() + std::size_t(law.inputs) * lanes];
          for (int i = 0; i < K; ++i) {
            double *to = out + (std::size_t(K) * law.element[p] + i) * width_ + first;
            for (int l = 0; l < lanes; ++l) to[l] += law.area[p] * (moved[lanes * i + l] + grown[l] * stress[i]);
          }
        }
      }
    }
  }
  // Derivatives of the internal variables after the step, from those of the strains at its end (elements, K, columns);
  // before `end`.
  template <class F> void end_columns(F &&strain, const std::vector<double> &slopes) {
    for (Law &law : laws_) {
      if (!law.states) continue;
      law.see(strain);
      std::vector<double> after(law.d_state.size());
      for (int first = 0; first < width_; first += lanes) {
        law.change(slopes.data(), before_.data(), first);
        law.push_memory();
        for (int p = 0; p < law.count; ++p)
          for (int z = 0; z < law.states; ++z)
            std::copy_n(law.pushed(p) + lanes * z, lanes, &after[(std::size_t(law.states) * p + z) * width_ + first]);
      }
      law.d_state.swap(after);
    }
    restart(slopes);
  }
  // The next step starts where strains have these derivatives.
  void restart(const std::vector<double> &slopes) { before_ = slopes; }

  // State of a law of the record and its derivatives, null where it is none of these.
  std::vector<double> *state(int law, bool derivatives) {
    for (Law &own : laws_)
      if (own.number == law) return derivatives ? &own.d_state : &own.state;
    return nullptr;
  }

 private:
  template <class> friend struct Pull;

  struct Law {
    int number, count, inputs, states, width;
    const int32_t *element;
    const double *area;
    std::vector<double> rows, state, d_state, out, moved, result;

    Law(const Record &r, int k)
        : number(k), count(r.material_start[k + 1] - r.material_start[k]), inputs(r.material_inputs[k]),
          states(r.material_states[k]), width(int(r.columns)), element(r.material_element + r.material_start[k]),
          area(r.material_area + r.material_start[k]),
          rows(r.material_row + r.material_row_start[k], r.material_row + r.material_row_start[k + 1]), r_(r) {
      state.assign(std::size_t(states) * count, 0.0);
      d_state.assign(state.size() * width, 0.0);
      out.resize(std::size_t(1 + K + K * K) * count);
      if (width) {
        moved.resize(std::size_t(changes()) * count);
        result.resize(std::size_t(widest()) * lanes * count);
      }
    }
    double *row(int p) { return &rows[std::size_t(inputs) * p]; }
    int first_state() const { return 2 * K + K * K; }
    std::size_t changes() const { return std::size_t(inputs + 1) * lanes; }
    const double *pushed(int p) const { return &result[std::size_t(widest()) * lanes * p]; }
    int widest() const { return std::max(K, states); }

    template <class F> void see(F &&strain) {
      for (int p = 0; p < count; ++p) strain(element[p], row(p));
    }
    void exert() { function<StressFunction>(0)(count, rows.data(), out.data()); }
    void respond() { function<StressFunction>(1)(count, rows.data(), out.data()); }
    void remember() { function<StressFunction>(2)(count, rows.data(), state.data()); }
    void push_stress() { push(3); }
    void push_memory() { push(4); }
    void push(int which) {
      for (int p = 0; p < count; ++p)  // one by one, since the change of the area stands behind each row
        function<PushFunction>(which)(1, row(p), &moved[p * changes()], &result[std::size_t(widest()) * lanes * p]);
    }
    template <class T> T function(int which) const { return reinterpret_cast<T>(r_.material_function[5 * number + which]); }

    // Changes of rows, and of the logarithm of areas, in some columns; `end`, `start`: of strains, null where held.
    void change(const double *end, const double *start, int first) {
      std::fill(moved.begin(), moved.end(), 0.0);
      auto take = [&](const double *from, int rows_of, int at, int from_row, int p) {
        for (int i = 0; i < rows_of; ++i)
          std::copy_n(from + (std::size_t(rows_of) * from_row + i) * width + first, lanes,
                      &moved[p * changes() + std::size_t(at + i) * lanes]);
      };
      for (int p = 0; p < count; ++p) {
        if (end) take(end, K, 0, element[p], p);
        take(start, K, K, element[p], p);
        take(d_state.data(), states, first_state(), p, p);
      }
      for (int b = r_.material_block_start[number]; b < r_.material_block_start[number + 1]; ++b) {
        const int lane = r_.material_of[b] - first;
        if (lane < 0 || lane >= lanes) continue;
        const double *by = r_.d_material_row + r_.material_block_row[b];
        for (int p = 0; p < count; ++p)
          for (int i = 0; i <= inputs; ++i) moved[p * changes() + std::size_t(i) * lanes + lane] += by[(inputs + 1) * p + i];
      }
    }

   private:
    const Record &r_;
  };

  const Record &r_;
  int width_;
  std::vector<Law> laws_;
  std::vector<double> stress_, tangent_, before_;
};

}  // namespace thinshell
