// The incremental potential of one step over the unknowns: energy, residual, Hessian and its factor.
//
//     Phi(x) = 1/2 (x - xhat)^T M (x - xhat) / tau^2 + 1/(2 tau) (x - x_b)^T D (x - x_b) - x . q + sum of elements
//
// M: mass, D: damping by mass, q: weight and dead loads; xhat = x_b + tau v_b (sim_core/solve/integrator.py).
#pragma once

#include <vector>

#include "affine.hpp"
#include "blocks.hpp"
#include "couples.hpp"
#include "drag.hpp"
#include "factor.hpp"
#include "guides.hpp"
#include "hinges.hpp"
#include "loads.hpp"
#include "record.hpp"
#include "tetrahedra.hpp"
#include "touching.hpp"
#include "triangles.hpp"
#include "vectors.hpp"
#include "yielding.hpp"

namespace thinshell {

// From what velocity and acceleration at the end of a step are measured; `end`: time then [s].
struct Step {
  double dt, tau, now, before, end;
  Values x_base, v_base;
};

class System {
 public:
  using Values = thinshell::Values;
  using Corrections = thinshell::Corrections;
  using Memory = thinshell::Memory;

  explicit System(const Record &record)
      : r_(record), triangles(record), hinges(record), tetrahedra(record), drag(record), loads(record), bodies(record),
        guides(record), couples(record), embedding(record), yielding(record),
        contacts(record), hessian(record.rank, int(record.nodes)) {
    whole_ = 3 * r_.nodes + yielding.count();
    x.assign(whole_, 0.0);
    gradient.assign(whole_, 0.0);
    touch_.assign(whole_, 0.0);
    predicted_.assign(whole_, 0.0);
    base_.assign(whole_, 0.0);
    std::vector<int> order(r_.nodes);
    for (int i = 0; i < r_.nodes; ++i) order[r_.rank[i]] = i;
    number_.assign(whole_, -1);
    embedded_.assign(r_.nodes, -1);
    for (int e = 0; e < embedding.count(); ++e) embedded_[embedding.node(e)] = e;
    for (int i : order)
      for (int k = 0; k < 3; ++k)
        if (!r_.prescribed[3 * i + k] && embedded_[i] < 0) {
          number_[3 * i + k] = int(own.size());
          own.push_back(3 * i + k);
        }
    for (int a = 0; a < yielding.count(); ++a) {
      number_[yielding.first() + a] = int(own.size());
      own.push_back(yielding.first() + a);
    }
    triangles.couple(hessian);
    hinges.couple(hessian);
    tetrahedra.couple(hessian);
    drag.couple(hessian);
    loads.couple(hessian);
    bodies.couple(hessian);
    guides.couple(hessian);
    couples.couple(hessian);
    contacts.shapes.couple(hessian);
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) hessian.couple(i, r_.mass_column[k]);
    lay_out();
  }

  int count() const { return int(own.size()); }
  std::size_t whole() const { return whole_; }

  // `towards`: where velocities and targets let nodes go, on the way to which contact is looked for.
  void begin(const Step &step, const double *x_start, const double *x_past, const double *towards, const double *turned,
             const Memory &memory, bool inertia) {
    x_start_ = x_start;
    load_ = largest(r_.external, whole_);
    prepare(x_start, towards, false);
    tau_ = step.tau;
    pull_ = inertia ? 1.0 / (tau_ * tau_) : 0.0;
    for (std::size_t k = 0; k < whole_; ++k) predicted_[k] = step.x_base[k] + step.tau * step.v_base[k];
    base_ = step.x_base;
    const Rates rates{step.now, step.before, step.tau, step.dt};
    triangles.begin(x_start, x_past, rates);
    hinges.begin(x_start, x_past, rates);
    tetrahedra.begin(x_start, x_past, rates);
    drag.begin(x_start, step.dt);
    loads.begin(x_start, step.end);
    couples.begin(x_start);
    contacts.begin(x_start, turned, memory);
  }

  // Take note of what bodies remember of a step that ended here.
  void end() {
    triangles.end(x.data());
    hinges.end(x.data());
    tetrahedra.end(x.data());
  }
  // What a material law remembers, or the derivatives of that.
  std::vector<double> &material(int law, bool derivatives) {
    for (auto *found : {triangles.laws.state(law, derivatives), hinges.laws.state(law, derivatives)})
      if (found) return *found;
    return *tetrahedra.laws.state(law, derivatives);
  }

  // Look for contact again if the way to `x` leads beyond what was looked at; true when it does.
  bool cover() {
    if (!contacts.outran(x.data())) return false;
    prepare(x_start_, x.data(), true);
    contacts.begin_surfaces(x_start_);
    return true;
  }

  // Let inertia hold the system where it is, over a time `tau` [s], until `untether`.
  void tether(double tau) {
    free_pull_ = pull_;
    free_predicted_ = predicted_;
    pull_ = 1.0 / (tau * tau);
    predicted_ = x;
  }
  void untether() {
    pull_ = free_pull_;
    predicted_ = free_predicted_;
  }

  Values unknowns() const {
    Values out(count());
    for (int k = 0; k < count(); ++k) out[k] = x[own[k]];
    return out;
  }
  void go(const Values &start, double share, const Values &direction) {
    for (int k = 0; k < count(); ++k) x[own[k]] = start[k] + share * direction[k];
    yielding.place(held_.data(), x.data());
    embedding.fill(x.data());
  }
  // Be where nodes are at `where` (nodes, 3).
  void put(const Values &where) { x = where; }
  // Moves of what is prescribed from where nodes are at `from` to its targets (nodes, 3).
  Values prescribed_move(const Values &from, const Values &targets) const {
    Values out = stripped(from);
    for (std::size_t k = 0; k < whole_; ++k) out[k] = r_.prescribed[k] ? targets[k] - out[k] : 0.0;
    embedding.fill(out.data());
    return out;
  }
  // Positions as they are where mounts do not give way.
  Values stripped(const Values &there) const {
    Values out = there;
    yielding.strip(out.data());
    return out;
  }
  // Whether an element is turned inside out on the way from `from`.
  bool turns_over(const Values &from) const { return tetrahedra.turns_over(from.data(), x.data()); }
  // Place what is prescribed at targets (nodes, 3), as far as mounts do not give way.
  void hold(const double *targets) {
    for (std::size_t k = 0; k < whole_; ++k)
      if (r_.prescribed[k]) x[k] = targets[k];
    if (yielding.any()) held_.assign(targets, targets + whole_);
    yielding.place(held_.data(), x.data());
    embedding.fill(x.data());
  }
  Values spread(const Values &direction) const {
    Values out(whole_, 0.0);
    for (int k = 0; k < count(); ++k) out[own[k]] = direction[k];
    yielding.follow(out.data());
    embedding.fill(out.data());
    return out;
  }
  // Let free bodies have the strain that the move of their nodes from `start` has to first order; false: there are none.
  bool straighten(const Values &start) {
    if (!r_.bodies) return false;
    std::vector<bool> free(whole_);
    for (std::size_t k = 0; k < whole_; ++k) free[k] = number_[k] >= 0;
    bodies.straighten(start.data(), free, x.data());
    embedding.fill(x.data());
    return true;
  }

  double energy() {
    double out = 0.0;
    for (std::size_t k = 0; k < whole_; ++k) out -= r_.external[k] * x[k];
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) {
        const int j = r_.mass_column[k];
        const double rub = r_.mass_damping[k] / tau_;
        for (int c = 0; c < 3; ++c) {
          out += 0.5 * pull_ * r_.mass[k] * (x[3 * i + c] - predicted_[3 * i + c]) * (x[3 * j + c] - predicted_[3 * j + c]);
          if (rub != 0.0) out += 0.5 * rub * (x[3 * i + c] - base_[3 * i + c]) * (x[3 * j + c] - base_[3 * j + c]);
        }
      }
    return out + triangles.energy(x.data()) + hinges.energy(x.data()) + tetrahedra.energy(x.data()) + drag.energy(x.data()) +
           loads.energy(x.data()) + bodies.energy(x.data()) + guides.energy(x.data()) + couples.energy(x.data()) + yielding.energy(x.data()) +
           contacts.energy(x.data());
  }

  // Residual over the unknowns [N]; the gradient by all nodes stays in `gradient`.
  Values residual() {
    ++residuals;
    if (contacts.any()) touch();
    for (std::size_t k = 0; k < whole_; ++k) gradient[k] = touch_[k] - r_.external[k];
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) {
        const int j = r_.mass_column[k];
        const double pull = pull_ * r_.mass[k], rub = r_.mass_damping[k] / tau_;
        for (int c = 0; c < 3; ++c)
          gradient[3 * i + c] += pull * (x[3 * j + c] - predicted_[3 * j + c]) + rub * (x[3 * j + c] - base_[3 * j + c]);
      }
    triangles.add_gradient(x.data(), gradient.data());
    hinges.add_gradient(x.data(), gradient.data());
    tetrahedra.add_gradient(x.data(), gradient.data());
    drag.add_gradient(x.data(), gradient.data());
    loads.add_gradient(x.data(), gradient.data());
    bodies.add_gradient(x.data(), gradient.data());
    guides.add_gradient(x.data(), gradient.data());
    couples.add_gradient(x.data(), gradient.data());
    yielding.add_gradient(x.data(), gradient.data());
    return gathered(gradient);
  }

  // Of the gradient at the last residual what elements and contacts exert, without inertia, weight and dead loads
  // (nodes, 3).
  void exerted(double *out) const {
    for (int k = 0; k < 3 * r_.nodes; ++k) out[k] = gradient[k] + r_.external[k];
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k)
        for (int c = 0; c < 3; ++c) {
          const int at = 3 * r_.mass_column[k] + c;
          out[3 * i + c] -= pull_ * r_.mass[k] * (x[at] - predicted_[at]);
        }
  }

  // Work of contact forces along a direction of the unknowns [J].
  double contact_along(const Values &direction) {
    touch();
    const Values force = gathered(touch_);
    double out = 0.0;
    for (int k = 0; k < count(); ++k) out += force[k] * direction[k];
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
    ++stamp_;
    hessian.clear();
    for (std::size_t k = 0; k < mass_slot_.size(); ++k)
      if (mass_slot_[k] >= 0)
        hessian.add_diagonal({mass_slot_[k], false}, pull_ * r_.mass[k] + r_.mass_damping[k] / tau_);
    triangles.add_hessian(x.data(), move, exact, hessian);
    hinges.add_hessian(x.data(), exact, hessian);
    tetrahedra.add_hessian(x.data(), exact, hessian);
    drag.add_hessian(x.data(), hessian);
    loads.add_hessian(x.data(), exact, hessian);
    bodies.add_hessian(x.data(), move, exact, hessian);
    guides.add_hessian(x.data(), exact, hessian);
    couples.add_hessian(x.data(), exact, hessian);
    contacts.add_hessian(x.data(), exact, hessian);
    stiffest_ = 0.0;
    for (std::size_t k = 0; k < diagonal_.size(); ++k) stiffest_ = std::max(stiffest_, std::abs(entry(diagonal_[k])));
  }
  double stiffest() const { return stiffest_; }
  // Changes with the Hessian and its factor.
  int64_t stamp() const { return stamp_; }
  // 1 / tau^2 where inertia counts, else 0.
  double pull() const { return pull_; }

  bool factorise(bool definite, double shift = 0.0) {
    ++stamp_;
    factor.clear();
    for (const Whole &w : wholes_) {
      const double *from = hessian.block(w.block);
      for (int q = 0; q < 3; ++q)
        for (int p = 0; p < 3; ++p) factor[w.to[q] + p] = from[3 * p + q];
    }
    for (const Entry &e : entries_) factor[e.to] = entry(e);
    for (const auto &[e, weight] : folded_) factor[e.to] += weight * entry(e);
    for (int a = 0; a < yielding.count(); ++a) {
      const int k = number_[yielding.first() + a];
      factor[factor.place(k, k)] += yielding.spring(a);
    }
    if (shift != 0.0)
      for (int k = 0; k < count(); ++k) factor[factor.place(k, k)] += shift;
    return factor.factorise(definite);
  }

  // H^-1 of a residual, in place.
  void solve(Values &v) const { factor.solve(v.data()); }

  // H dx of moves of what is prescribed, over the unknowns.
  Values follow(const Values &move) const {
    Values out(whole_, 0.0);
    hessian.multiply(move.data(), out.data(), 1);
    contacts.shapes.follow(move.data(), out.data());
    return gathered(out);
  }

  Values gathered(const Values &nodal) const {
    if (embedding.any() || yielding.any()) {
      Values folded = nodal;
      fold(folded.data());
      return picked(folded);
    }
    return picked(nodal);
  }
  // Carry forces on what follows others to these, `width` columns, innermost.
  void fold(double *force, int width = 1) const {
    embedding.fold(force, width);
    yielding.fold(force, width);
  }
  Values picked(const Values &nodal) const {
    Values out(count());
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
    ++stamp_;
    hessian.lay_out(contacts.pairs());
    triangles.bind(hessian);
    hinges.bind(hessian);
    tetrahedra.bind(hessian);
    drag.bind(hessian);
    loads.bind(hessian);
    bodies.bind(hessian);
    guides.bind(hessian);
    couples.bind(hessian);
    contacts.bind(hessian);
    mass_slot_.clear();
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) {
        const Slot slot = hessian.slot(i, r_.mass_column[k]);
        mass_slot_.push_back(slot.turned ? -1 : slot.at);
      }
    lay_out_factor();
    std::vector<bool> held(r_.nodes, false);
    for (int k = 0; k < 3 * r_.nodes; ++k) held[k / 3] = held[k / 3] || r_.prescribed[k];
    for (int e = 0; e < embedding.count(); ++e) held[embedding.node(e)] = true;
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

  // The unknown that a component of a node moves with, -1: none.
  int unknown(int component) const {
    const int lead = yielding.lead(component);
    return lead < 0 ? number_[component] : number_[lead];
  }

  // Entries of blocks of nodes that follow others, with what they add to which unknowns: f(block, of, row, column, weight).
  template <class F> void each_folded(F &&f) const {
    const auto parts = [&](int node) {
      std::vector<std::pair<int, double>> out;
      const int e = embedded_[node];
      if (e < 0) return std::vector<std::pair<int, double>>{{node, 1.0}};
      for (int k = embedding.begin(e); k < embedding.end(e); ++k) out.emplace_back(embedding.in(k), embedding.weight(k));
      return out;
    };
    if (!embedding.any() && !yielding.any()) return;
    const auto follows = [&](int node) { return embedded_[node] >= 0 || yielding.leads(node); };
    for (int i = 0; i < hessian.nodes(); ++i)
      for (int b = hessian.begin(i); b < hessian.end(i); ++b) {
        const int j = hessian.column(b);
        if (!follows(i) && !follows(j)) continue;
        for (const auto &[p, by] : parts(i))
          for (const auto &[q, with] : parts(j))
            for (int k = 0; k < 9; ++k) {
              const int row = unknown(3 * p + k / 3), column = unknown(3 * q + k % 3);
              if (row < 0 || column < 0 || (i == j && row < column)) continue;  // a diagonal block has both halves
              if (p == i && q == j && number_[3 * i + k / 3] >= 0 && number_[3 * j + k % 3] >= 0) continue;  // its own
              const double twice = i != j && row == column ? 2.0 : 1.0;
              f(b, k, std::max(row, column), std::min(row, column), twice * by * with);
            }
      }
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
    each_folded([&](int, int, int row, int column, double) { rows[column].push_back(row); });
    for (int a = 0; a < yielding.count(); ++a) {
      const int k = number_[yielding.first() + a];
      rows[k].push_back(k);
    }
    for (auto &row : rows) {
      std::sort(row.begin(), row.end());
      row.erase(std::unique(row.begin(), row.end()), row.end());
    }
    factor.lay_out(rows);
    folded_.clear();
    each_folded([&](int b, int of, int row, int column, double weight) {
      folded_.push_back({{b, of, factor.place(column, row)}, weight});
    });
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
  double tau_ = 1.0, pull_ = 0.0, stiffest_ = 0.0, load_ = 0.0;  // pull_: 1 / tau^2 where inertia counts, else 0
  const double *x_start_ = nullptr;
  double free_pull_ = 0.0;
  int64_t stamp_ = 0;
  Values touch_, predicted_, base_, free_predicted_, held_;
  std::vector<int> number_, mass_slot_;
  std::vector<Entry> entries_, diagonal_;
  std::vector<Whole> wholes_;
  std::vector<int> embedded_;                        // which of the embedded nodes each node is, -1: none
  std::vector<std::pair<Entry, double>> folded_;

 public:
  Triangles triangles;
  Hinges hinges;
  Tetrahedra tetrahedra;
  Drag drag;
  Loads loads;
  Bodies bodies;
  Guides guides;
  Couples couples;
  Embedding embedding;
  Yielding yielding;
  Touching contacts;
  Blocks hessian;
  Factor factor;
  Values x, gradient;
  std::vector<int> own;  // component of each unknown
  int64_t residuals = 0;
};

}  // namespace thinshell
