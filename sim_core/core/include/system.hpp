// The incremental potential of one step over the unknowns: energy, residual, Hessian and its factor.
//
//     Phi(x) = 1/2 (x - xhat)^T M (x - xhat) / tau^2 + 1/(2 tau) (x - x_b)^T D (x - x_b) - x . q + sum of elements
//
// M: mass, D: damping by mass, q: weight and dead loads; xhat = x_b + tau v_b (sim_core/solve/integrator.py).
#pragma once

#include <vector>

#include "blocks.hpp"
#include "elements.hpp"
#include "factor.hpp"
#include "record.hpp"
#include "tetrahedra.hpp"
#include "touching.hpp"

namespace thinshell {

inline double largest(const double *v, std::size_t count) {
  double out = 0.0;
  for (std::size_t k = 0; k < count; ++k) {
    const double a = std::abs(v[k]);
    if (!(a <= out)) out = a;  // a value that is no number stays
  }
  return out;
}

// From what velocity and acceleration at the end of a step are measured.
struct Step {
  double dt, tau, now, before;
  std::vector<double> x_base, v_base;
};

class System {
 public:
  explicit System(const Record &record)
      : r_(record), triangles(record), hinges(record), tetrahedra(record), contacts(record), hessian(record.rank, int(record.nodes)) {
    whole_ = 3 * r_.nodes;
    x.assign(whole_, 0.0);
    gradient.assign(whole_, 0.0);
    touch_.assign(whole_, 0.0);
    predicted_.assign(whole_, 0.0);
    base_.assign(whole_, 0.0);
    std::vector<int> order(r_.nodes);
    for (int i = 0; i < r_.nodes; ++i) order[r_.rank[i]] = i;
    number_.assign(whole_, -1);
    for (int i : order)
      for (int k = 0; k < 3; ++k)
        if (!r_.prescribed[3 * i + k]) {
          number_[3 * i + k] = int(own.size());
          own.push_back(3 * i + k);
        }
    triangles.couple(hessian);
    hinges.couple(hessian);
    tetrahedra.couple(hessian);
    contacts.shapes.couple(hessian);
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) hessian.couple(i, r_.mass_column[k]);
    lay_out();
    load_ = largest(r_.external, whole_);
  }

  int count() const { return int(own.size()); }
  std::size_t whole() const { return whole_; }

  // `towards`: where velocities and targets let nodes go, on the way to which contact is looked for.
  void begin(const Step &step, const double *x_start, const double *x_past, const double *towards, const double *turned,
             const Memory &memory, bool inertia) {
    x_start_ = x_start;
    prepare(x_start, towards, false);
    tau_ = step.tau;
    inertia_ = inertia;
    for (std::size_t k = 0; k < whole_; ++k) predicted_[k] = step.x_base[k] + step.tau * step.v_base[k];
    base_ = step.x_base;
    const Rates rates{step.now, step.before, step.tau};
    triangles.begin(x_start, x_past, rates);
    hinges.begin(x_start, x_past, rates);
    tetrahedra.begin(x_start, x_past, rates);
    contacts.begin(x_start, turned, memory);
  }

  // Look for contact again if the way to `x` leads beyond what was looked at; true when it does.
  bool cover() {
    if (!contacts.outran(x.data())) return false;
    prepare(x_start_, x.data(), true);
    contacts.begin_surfaces(x_start_);
    return true;
  }

  std::vector<double> unknowns() const {
    std::vector<double> out(count());
    for (int k = 0; k < count(); ++k) out[k] = x[own[k]];
    return out;
  }
  void go(const std::vector<double> &start, double share, const std::vector<double> &direction) {
    for (int k = 0; k < count(); ++k) x[own[k]] = start[k] + share * direction[k];
  }
  // Place what is prescribed at targets (nodes, 3).
  void hold(const double *targets) {
    for (std::size_t k = 0; k < whole_; ++k)
      if (r_.prescribed[k]) x[k] = targets[k];
  }
  std::vector<double> spread(const std::vector<double> &direction) const {
    std::vector<double> out(whole_, 0.0);
    for (int k = 0; k < count(); ++k) out[own[k]] = direction[k];
    return out;
  }

  double energy() {
    double out = 0.0;
    for (std::size_t k = 0; k < whole_; ++k) out -= r_.external[k] * x[k];
    const double factor = inertia_ ? 1.0 / (tau_ * tau_) : 0.0;
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) {
        const int j = r_.mass_column[k];
        const double rub = r_.mass_damping[k] / tau_;
        for (int c = 0; c < 3; ++c) {
          out += 0.5 * factor * r_.mass[k] * (x[3 * i + c] - predicted_[3 * i + c]) * (x[3 * j + c] - predicted_[3 * j + c]);
          if (rub != 0.0) out += 0.5 * rub * (x[3 * i + c] - base_[3 * i + c]) * (x[3 * j + c] - base_[3 * j + c]);
        }
      }
    return out + triangles.energy(x.data()) + hinges.energy(x.data()) + tetrahedra.energy(x.data()) +
           contacts.energy(x.data());
  }

  // Residual over the unknowns [N]; the gradient by all nodes stays in `gradient`.
  std::vector<double> residual() {
    ++residuals;
    if (contacts.any()) touch();
    for (std::size_t k = 0; k < whole_; ++k) gradient[k] = touch_[k] - r_.external[k];
    const double factor = inertia_ ? 1.0 / (tau_ * tau_) : 0.0;
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) {
        const int j = r_.mass_column[k];
        const double pull = factor * r_.mass[k], rub = r_.mass_damping[k] / tau_;
        for (int c = 0; c < 3; ++c)
          gradient[3 * i + c] += pull * (x[3 * j + c] - predicted_[3 * j + c]) + rub * (x[3 * j + c] - base_[3 * j + c]);
      }
    triangles.add_gradient(x.data(), gradient.data());
    hinges.add_gradient(x.data(), gradient.data());
    tetrahedra.add_gradient(x.data(), gradient.data());
    return gathered(gradient);
  }

  // Work of contact forces along a direction of the unknowns [J].
  double contact_along(const std::vector<double> &direction) {
    touch();
    double out = 0.0;
    for (int k = 0; k < count(); ++k) out += touch_[own[k]] * direction[k];
    return out;
  }
  // Largest force of contact on a node [N].
  double contact_load() {
    if (!contacts.any()) return 0.0;
    touch();
    return largest(touch_.data(), whole_);
  }

  double largest_load() const { return load_; }
  double force_scale() const { return std::max(largest(gradient.data(), whole_), load_); }
  double force_noise() const {
    return std::numeric_limits<double>::epsilon() * stiffest_ * largest(x.data(), whole_);
  }

  // `move`: by which the stress of the Hessian is foreseen, null: the true one.
  void assemble(bool exact, const double *move) {
    hessian.clear();
    const double factor = inertia_ ? 1.0 / (tau_ * tau_) : 0.0;
    for (std::size_t k = 0; k < mass_slot_.size(); ++k)
      if (mass_slot_[k] >= 0)
        hessian.add_diagonal({mass_slot_[k], false}, factor * r_.mass[k] + r_.mass_damping[k] / tau_);
    triangles.add_hessian(x.data(), move, exact, hessian);
    hinges.add_hessian(x.data(), exact, hessian);
    tetrahedra.add_hessian(x.data(), exact, hessian);
    contacts.add_hessian(x.data(), exact, hessian);
    stiffest_ = 0.0;
    for (std::size_t k = 0; k < diagonal_.size(); ++k) stiffest_ = std::max(stiffest_, std::abs(entry(diagonal_[k])));
  }
  double stiffest() const { return stiffest_; }

  bool factorise(bool definite, double shift = 0.0) {
    factor.clear();
    for (const Whole &w : wholes_) {
      const double *from = hessian.block(w.block);
      for (int q = 0; q < 3; ++q)
        for (int p = 0; p < 3; ++p) factor[w.to[q] + p] = from[3 * p + q];
    }
    for (const Entry &e : entries_) factor[e.to] = entry(e);
    if (shift != 0.0)
      for (int k = 0; k < count(); ++k) factor[factor.place(k, k)] += shift;
    return factor.factorise(definite);
  }

  // H dx of moves of what is prescribed, over the unknowns.
  std::vector<double> follow(const std::vector<double> &move) const {
    std::vector<double> out(whole_, 0.0);
    hessian.multiply(move.data(), out.data(), 1);
    return gathered(out);
  }

  std::vector<double> gathered(const std::vector<double> &nodal) const {
    std::vector<double> out(count());
    for (int k = 0; k < count(); ++k) out[k] = nodal[own[k]];
    return out;
  }

 private:
  struct Entry {
    int block, of;
    std::size_t to;
  };
  // A block off the diagonal, all components of whose nodes are unknown: where its columns go.
  struct Whole {
    int block;
    std::size_t to[3];
  };

  double entry(const Entry &e) const { return hessian.block(e.block)[e.of]; }
  void touch() {
    std::fill(touch_.begin(), touch_.end(), 0.0);
    contacts.add_gradient(x.data(), touch_.data());
  }

  // The pattern of the Hessian and of its factor, with the pairs of nodes that contact couples now.
  void lay_out() {
    hessian.lay_out(contacts.pairs());
    triangles.bind(hessian);
    hinges.bind(hessian);
    tetrahedra.bind(hessian);
    contacts.bind(hessian);
    mass_slot_.clear();
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) {
        const Slot slot = hessian.slot(i, r_.mass_column[k]);
        mass_slot_.push_back(slot.turned ? -1 : slot.at);
      }
    lay_out_factor();
    std::vector<bool> held(r_.nodes, false);
    for (std::size_t k = 0; k < whole_; ++k) held[k / 3] = held[k / 3] || r_.prescribed[k];
    hessian.border(held);
  }

  // Look for contact from `x_start` to `towards`.
  void prepare(const double *x_start, const double *towards, bool more) {
    if (!contacts.prepare(x_start, towards, more)) return;
    const auto &pairs = contacts.pairs();
    const bool inside = std::all_of(pairs.begin(), pairs.end(), [&](auto &p) { return hessian.has(p.first, p.second); });
    if (inside)
      contacts.bind(hessian);
    else
      lay_out();
  }

  // Where the entries over the unknowns are in the factor.
  void lay_out_factor() {
    entries_.clear();
    diagonal_.clear();
    wholes_.clear();
    std::vector<std::vector<int>> rows(count());
    auto each = [&](auto &&f) {
      for (int i = 0; i < hessian.nodes(); ++i)
        for (int b = hessian.begin(i); b < hessian.end(i); ++b)
          for (int p = 0; p < 3; ++p)
            for (int q = 0; q < 3; ++q) {
              const int row = number_[3 * i + p], column = number_[3 * hessian.column(b) + q];
              if (row >= 0 && column >= 0 && column <= row) f(b, 3 * p + q, row, column);
            }
    };
    each([&](int, int, int row, int column) { rows[column].push_back(row); });
    for (auto &row : rows) std::sort(row.begin(), row.end());
    factor.lay_out(rows);
    std::vector<std::vector<Entry>> of_block;
    each([&](int b, int of, int row, int column) {
      if (of_block.empty() || of_block.back().front().block != b) of_block.emplace_back();
      of_block.back().push_back({b, of, factor.place(column, row)});
      if (row == column) diagonal_.push_back(of_block.back().back());
    });
    for (const auto &found : of_block) {
      if (found.size() == 9)  // of the first row, p = 0, where each of the columns begins
        wholes_.push_back({found[0].block, {found[0].to, found[1].to, found[2].to}});
      else
        entries_.insert(entries_.end(), found.begin(), found.end());
    }
  }

  const Record &r_;
  std::size_t whole_;
  double tau_ = 1.0, stiffest_ = 0.0, load_ = 0.0;
  bool inertia_ = true;
  const double *x_start_ = nullptr;
  std::vector<double> touch_, predicted_, base_;
  std::vector<int> number_, mass_slot_;
  std::vector<Entry> entries_, diagonal_;
  std::vector<Whole> wholes_;

 public:
  Triangles triangles;
  Hinges hinges;
  Tetrahedra tetrahedra;
  Touching contacts;
  Blocks hessian;
  Factor factor;
  std::vector<double> x, gradient;
  std::vector<int> own;  // component of each unknown
  int64_t residuals = 0;
};

}  // namespace thinshell
