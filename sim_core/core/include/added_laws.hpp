// Laws that effects add to the contact of one term (sim_core/contact/added_laws.py):
//
//     p = p_0 + sum_i p_i(g),    friction bound = mu l prod_i f_i(l / A, slip speed),    l = A p_0
//
// Each law is one formula, an energy of the gap or a factor, that is compiled by itself with its derivatives by all
// arguments (sim_core/core/pointwise.py) and called here by its address, at the points that touch. Its arguments after
// the gap, or after pressure and speed, are numbers of the effect.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "lanes.hpp"
#include "record.hpp"
#include "traced.hpp"

namespace thinshell {

// `evaluate` of a compiled law for n points: k rows of arguments, then the value, its k derivatives, and of those of
// second order the lower triangle, row by row.
using LawFunction = void (*)(long n, double *x);

class AddedLaws {
 public:
  struct Normal {
    double energy = 0.0, pressure = 0.0, slope = 0.0;  // [J/m^2], [Pa], [Pa/m]
  };

  // Those of the contact `term`: shapes, then surfaces, then edges.
  AddedLaws(const Record &record, int64_t term) : r_(record), bond_reach_(r_.bond_reach[term]) {
    for (int k = r_.added_start[term]; k < r_.added_start[term + 1]; ++k)
      (r_.added_kind[k] == FRICTION ? friction_ : normal_).push_back(k);
    for (auto &laws : {normal_, friction_})
      for (int k : laws) {
        const std::size_t most = 2 + r_.added_number_start[k + 1] - r_.added_number_start[k];
        x_.resize(std::max(x_.size(), 2 * most + 1 + most * (most + 1) / 2));
      }
  }

  bool presses() const { return !normal_.empty(); }

  // At a gap within the reach of the term's law; `bonded`: 1 where the surfaces have touched, or the law never asks.
  Normal normal(double gap, double bonded) const {
    Normal out;
    double *x = x_.data();
    for (int k : normal_) {
      const double share = r_.added_kind[k] == BOND ? bonded : 1.0;
      const int count = evaluate(k, 1, &gap, x);
      out.energy += share * x[count];
      out.pressure -= share * x[count + 1];
      out.slope += share * x[2 * count + 1];
    }
    return out;
  }

  double pressure(double gap, double bonded, int) const { return normal(gap, bonded).pressure; }
  Lanes pressure(const Lanes &gap, double bonded, int first) const {
    Lanes out(0.0);
    double *x = x_.data();
    for (int k : normal_) {
      const double share = r_.added_kind[k] == BOND ? bonded : 1.0;
      const int count = evaluate(k, 1, &gap.v, x);
      const double *second = x + 2 * count + 1;
      out.v -= share * x[count + 1];
      for (int l = 0; l < lanes; ++l) out.d[l] -= share * second[0] * gap.d[l];
      for (int i = 1; i < count; ++i)
        for (int l = 0; l < lanes; ++l) out.d[l] -= share * second[i * (i + 1) / 2] * by(k, i - 1, first + l);
    }
    return out;
  }

  // Friction bound [N] of a point that carried `load` [N] on `area` [m^2] and slid at `speed` [m/s].
  double bound(double mu, double load, double area, double speed, int) const {
    double out = mu * load, *x = x_.data();
    if (load > 0.0)
      for (int k : friction_) {
        const double at[2] = {load / area, speed};
        out *= x[evaluate(k, 2, at, x)];
      }
    return out;
  }
  Lanes bound(const Lanes &mu, const Lanes &load, double area, const Lanes &speed, int first) const {
    Lanes out = mu * load;
    double *x = x_.data();
    if (load.v > 0.0)
      for (int k : friction_) {
        const double at[2] = {load.v / area, speed.v};
        const int count = evaluate(k, 2, at, x);
        const double *d = x + count + 1;
        Lanes factor(x[count]);
        for (int l = 0; l < lanes; ++l) {
          factor.d[l] = d[0] * load.d[l] / area + d[1] * speed.d[l];
          for (int i = 2; i < count; ++i) factor.d[l] += d[i] * by(k, i - 2, first + l);
        }
        out *= factor;
      }
    return out;
  }

  // Noted, where the numbers of all laws of the record stand on the trace from `first` on.
  Noted pressure(const Noted &gap, double bonded, int first) const {
    Noted out(0.0);
    double *x = x_.data();
    for (int k : normal_) {
      const double share = r_.added_kind[k] == BOND ? bonded : 1.0;
      const int count = evaluate(k, 1, &gap.v, x);
      const double *second = x + 2 * count + 1;
      Noted own(-share * x[count + 1]);
      own.at = Trace::active()->add(gap.at, -share * second[0], 0, 0.0);
      for (int i = 1; i < count; ++i)
        own.at = Trace::active()->add(own.at, 1.0, number(k, i - 1, first), -share * second[i * (i + 1) / 2]);
      out += own;
    }
    return out;
  }
  Noted bound(const Noted &mu, const Noted &load, const Noted &area, const Noted &speed, int first) const {
    Noted out = mu * load;
    double *x = x_.data();
    if (load.v > 0.0)
      for (int k : friction_) {
        const Noted pressure = load / area;
        const double at[2] = {pressure.v, speed.v};
        const int count = evaluate(k, 2, at, x);
        const double *d = x + count + 1;
        Noted factor(x[count]);
        factor.at = Trace::active()->add(pressure.at, d[0], speed.at, d[1]);
        for (int i = 2; i < count; ++i) factor.at = Trace::active()->add(factor.at, 1.0, number(k, i - 2, first), d[i]);
        out *= factor;
      }
    return out;
  }

  // Whether a point is bonded after a step that ended at a gap, 0 or 1.
  double bonded_after(double gap, bool touches, double before) const {
    return touches ? 1.0 : gap < bond_reach_ ? before : 0.0;
  }

 private:
  enum : int { PRESSURE, BOND, FRICTION };  // KINDS of sim_core/core/added.py

  // Evaluate a law at its first `given` arguments; returns how many it has.
  int evaluate(int k, int given, const double *at, double *x) const {
    const int numbers = r_.added_number_start[k + 1] - r_.added_number_start[k];
    std::copy(at, at + given, x);
    std::copy_n(r_.added_number + r_.added_number_start[k], numbers, x + given);
    reinterpret_cast<LawFunction>(r_.added_function[k])(1, x);
    return given + numbers;
  }
  int number(int k, int own, int first) const { return first + r_.added_number_start[k] + own; }
  // Derivative of a number of a law in a column.
  double by(int k, int number, int column) const {
    return r_.d_added_number[std::size_t(r_.added_number_start[k] + number) * r_.columns + column];
  }

  const Record &r_;
  std::vector<int> normal_, friction_;
  double bond_reach_;
  mutable std::vector<double> x_;  // arguments and results of a law
};

}  // namespace thinshell
