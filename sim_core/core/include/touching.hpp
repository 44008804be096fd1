// All contact of a system: with rigid shapes, of surfaces, and of edges.
#pragma once

#include <deque>

#include "edges.hpp"
#include "vectors.hpp"

namespace thinshell {

class Touching {
 public:
  explicit Touching(const Record &record) : shapes(record), r_(record) {
    for (int k = 0; k < r_.surfaces; ++k) surfaces.emplace_back(record, k);
    for (int k = 0; k < r_.edge_pairs; ++k) edges.emplace_back(record, k);
  }

  Contacts shapes;
  std::deque<Surface> surfaces;
  std::deque<EdgePairs> edges;

  bool any() const { return shapes.any() || !surfaces.empty() || !edges.empty(); }

  void guard(bool on) {
    shapes.guard(on);
    each([&](auto &term) { term.guard(on); });
  }

  // Look for what surfaces and edges may touch on the way from `x` to `towards`; true when the pairs of nodes that they
  // couple, `pairs`, changed.
  bool prepare(const double *x, const double *towards, bool more) {
    std::vector<bool> changed;
    each([&](auto &term) { changed.push_back(term.prepare(x, towards, more)); });
    if (std::find(changed.begin(), changed.end(), true) == changed.end()) return false;
    std::vector<PairTable::Pair> pairs;
    std::size_t k = 0;
    each([&](auto &term) {
      if (!changed[k++]) term.recouple(x, towards);
      term.couple(pairs);
    });
    table_.lay_out(std::move(pairs), int(r_.nodes));
    return true;
  }
  const std::vector<PairTable::Pair> &pairs() const { return table_.pairs(); }

  void bind(const Blocks &h) {
    shapes.bind(h);
    table_.bind(h);
  }
  void begin(const double *x_start, const double *turned, const Memory &memory) {
    shapes.begin(x_start, turned, memory);
    begin_surfaces(x_start);
  }
  void begin_surfaces(const double *x_start) {
    each([&](auto &term) { term.begin(x_start); });
  }
  // Whether something may have come into contact on the way to `x` that was not looked at.
  bool outran(const double *x) {
    bool out = false;
    each([&](auto &term) { out = out || term.outran(x); });
    return out;
  }

  void turn(double share, const Memory &memory) { shapes.turn(share, memory); }
  bool turns(const Memory &memory) const { return shapes.turns(memory); }

  double energy(const double *x) {
    double out = 0.0;
    each([&](auto &term) { term.add_energy(x, &out); });
    return out + shapes.energy(x);
  }
  void add_gradient(const double *x, double *out) {
    shapes.add_gradient(x, out);
    each([&](auto &term) { term.add_gradient(x, out); });
  }
  // Forces of each term on the nodes [N] (terms, nodes, 3): shapes, then surfaces, then edges.
  void forces(const double *x, std::vector<double> &out) {
    std::fill(out.begin(), out.end(), 0.0);
    const std::size_t apart = 3 * std::size_t(r_.nodes);
    shapes.add_gradient(x, out.data(), apart);
    double *at = out.data() + apart * r_.contacts;
    each([&](auto &term) {
      term.add_gradient(x, at);
      at += apart;
    });
    for (double &f : out) f = -f;
  }
  void add_hessian(const double *x, bool exact, Blocks &h) {
    shapes.add_hessian(x, exact, h);
    if (table_.empty()) return;
    table_.clear();
    each([&](auto &term) { term.add_hessian(x, exact, table_); });
    table_.add_to(h);
  }

  // Whether the guard may change the law at the gaps that were found last.
  bool guard_matters() {
    bool out = shapes.guard_matters();
    each([&](auto &term) { out = out || term.acts(); });
    return out;
  }
  double free_way(const Values &from, const Values &by, double keep, double since, double till, const Memory &memory) {
    const double *x = from.data(), *move = by.data();
    double way = shapes.free_way(x, move, keep, since, till, memory);
    each([&](auto &term) { way = std::min(way, term.free_way(x, move, keep)); });
    return way;
  }

  void end(const double *x, double dt, Memory &memory) {
    shapes.end(x, dt, memory);
    each([&](auto &term) { term.end(x, dt); });
  }

  // As of Contacts: what forces change by, and the derivatives of the memory.
  void add_columns(const double *x_start, const double *x, const double *dx_start, const double *dx,
                   const double *d_rotation, const Memory &memory, double *out) {
    shapes.add_columns(x_start, x, dx_start, dx, d_rotation, memory, out);
    each([&](auto &term) { term.add_columns(x, dx_start, out); });
  }
  void end_columns(const double *x_start, const double *x, const double *dx_start, const double *dx, double dt,
                   const double *d_rotation, Memory &memory, double *d_moments, double *d_force) {
    shapes.end_columns(x_start, x, dx_start, dx, dt, d_rotation, memory, d_moments, d_force);
    each([&](auto &term) { term.end_columns(x, dx_start, dx, dt); });
  }

  // Smallest gap [m] at the last gradient.
  double gap() {
    StepCounts found{};
    report(found);
    return found.gap;
  }

  // Loaded points, the smallest gap [m] and the contact that has it: shapes, then surfaces, then edges.
  void report(StepCounts &out) {
    shapes.report(out);
    int64_t at = r_.contacts;
    each([&](auto &term) {
      const auto [loaded, gap] = term.report();
      out.contacts += loaded;
      if (gap < out.gap && gap < nowhere) {
        out.gap = gap;
        out.tightest = at;
      }
      ++at;
    });
  }

 private:
  template <class F> void each(F &&f) {
    for (Surface &term : surfaces) f(term);
    for (EdgePairs &term : edges) f(term);
  }

  const Record &r_;
  PairTable table_;
};

}  // namespace thinshell
