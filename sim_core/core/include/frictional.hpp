// Contact with friction at points whose forces are on nodes alone, samples of a surface or pairs of edges: what they
// remember, and derivatives by columns, from one point at a time.
#pragma once

#include <utility>
#include <vector>

#include "contact.hpp"
#include "neighbours.hpp"

namespace thinshell {

// Gap [m] of what has no candidates (FAR of surface_kernels.py).
constexpr double nowhere = 1e30;

// What the points of a contact remember from one step to the next, with derivatives, columns innermost.
struct Held {
  std::vector<double> anchor, load, speed;        // (n, 3), (n), (n)
  std::vector<double> d_anchor, d_load, d_speed;  // (., columns) each

  void resize(std::size_t count, std::size_t columns) {
    anchor.assign(3 * count, 0.0);
    load.assign(count, 0.0);
    speed.assign(count, 0.0);
    d_anchor.assign(3 * count * columns, 0.0);
    d_load.assign(count * columns, 0.0);
    d_speed.assign(count * columns, 0.0);
  }
  void take(int at, const Held &from, int there, std::size_t columns) {
    auto some = [&](std::vector<double> &to, const std::vector<double> &of, std::size_t width) {
      std::copy_n(of.begin() + there * width, width, to.begin() + at * width);
    };
    some(anchor, from.anchor, 3);
    some(load, from.load, 1);
    some(speed, from.speed, 1);
    some(d_anchor, from.d_anchor, 3 * columns);
    some(d_load, from.d_load, columns);
    some(d_speed, from.d_speed, columns);
  }
};

// Of: Surface or EdgePairs. It has `reach`, the place in its law of the gap from which on nothing acts; `count()`; the
// kernels' numbers `step_`; `before()`, what its points remember from before the step; `spring(k)`; `list()` of new
// candidates; `any()` of them; `measure(x)`, the gaps; and One<Given>, one point of numbers with derivatives.
template <class Of> class Frictional {
 public:
  Held held;

  void guard(bool on) {
    set_guard(law_.data(), on);
    seen_.clear();
  }

  // Look for candidates on the way from `x` to `towards`; true when the coupled nodes changed.
  bool prepare(const double *x, const double *towards, bool more) {
    const auto changed = candidates_.search(x, towards, 3 * r_.nodes, law_[OFFSET] + law_[Of::reach], margin_, more);
    if (changed.inner) own().list();
    return changed.outer;
  }
  void recouple(const double *x, const double *towards) { candidates_.recouple(x, towards); }
  bool outran(const double *x) const { return candidates_.outran(x); }

  // Memory after the step that ended at `x`, from forces that were evaluated last.
  void end(const double *x, double dt) {
    auto &step = own().step_;
    Held after;
    after.resize(own().count(), 0);
    const bool any = look(x);
    for (int k = 0; any && k < own().count(); ++k) {
      if (!(step.load[k] > 0.0)) continue;
      const Vec3 slip = step.slip(rows(x), rows(x_start_), anchor(), k);
      const Vec3 kept = kept_slip(slip, step.limit[k], own().spring(k), dt, after.speed[k]);
      std::copy(kept.a, kept.a + 3, &after.anchor[3 * k]);
      after.load[k] = step.load[k];
    }
    held.anchor.swap(after.anchor);
    held.load.swap(after.load);
    held.speed.swap(after.speed);
  }

  // What forces change by where positions at the end are held, into (nodes, 3, columns).
  void add_columns(const double *x, const double *dx_start, double *out) {
    if (!look(x)) return;
    for (int k = 0; k < own().count(); ++k)
      if (acts(k))
        for (int first = 0; first < r_.columns; first += lanes) {
          typename Of::template One<InColumns> one(own(), k, x, {own(), k, first, dx_start, nullptr});
          for (std::size_t n = 0; n < std::size(one.out) / 3; ++n)
            scatter(&one.out[3 * n], 3, out + 3 * one.node(n) * r_.columns, r_.columns, first);
        }
  }
  // Derivatives of the memory after the step; before `end`.
  void end_columns(const double *x, const double *dx_start, const double *dx, double dt) {
    Held after;
    after.resize(own().count(), r_.columns);
    const bool any = look(x);
    for (int k = 0; any && k < own().count(); ++k)
      if (own().step_.load[k] > 0.0)
        for (int first = 0; first < r_.columns; first += lanes) {
          typename Of::template One<InColumns> one(own(), k, x, {own(), k, first, dx_start, dx});
          Lanes speed;
          const Vec<Lanes, 3> kept = one.slide(dt, speed);
          scatter(kept.a, 3, &after.d_anchor[3 * k * r_.columns], r_.columns, first);
          scatter(&one.step.load[0], 1, &after.d_load[k * r_.columns], r_.columns, first);
          scatter(&speed, 1, &after.d_speed[k * r_.columns], r_.columns, first);
        }
    held.d_anchor.swap(after.d_anchor);
    held.d_load.swap(after.d_load);
    held.d_speed.swap(after.d_speed);
  }

  // Whether any point touches or rubs, at the last gradient.
  bool acts() const {
    for (int k = 0; k < own().count(); ++k)
      if (acts(k)) return true;
    return false;
  }

  // Loaded points and the smallest gap [m], at the last gradient.
  std::pair<int64_t, double> report() const {
    int64_t loaded = 0;
    double smallest = nowhere;
    for (int k = 0; k < own().count(); ++k) {
      loaded += own().step_.load[k] > 0.0;
      smallest = std::min(smallest, own().step_.now.gap[k]);
    }
    return {loaded, smallest};
  }

 protected:
  // `law`, `d_law`: its eight numbers, and their derivatives (8, columns); `term`: its number among all contacts.
  template <class Distance>
  Frictional(const Record &record, double margin, const double *law, const double *d_law, int64_t term, Primitives ours,
             Primitives theirs, bool once, Distance distance)
      : r_(record), margin_(margin), law_(law, law + 8), d_law_(d_law), added_(r_, term),
        candidates_(std::move(ours), std::move(theirs), once, distance) {}
  Frictional(const Frictional &) = delete;

  // Numbers of one point with their derivatives in some columns; dx: of the positions at the end, null where held.
  struct InColumns {
    using S = Lanes;
    using A = double;
    const Of &of;
    int k, first;
    const double *dx_start, *dx;
    Lanes start(std::size_t n) const { return seeded(of.x_start_[n], dx_start + n * of.r_.columns + first); }
    Lanes end(std::size_t n, double at) const { return dx ? seeded(at, dx + n * of.r_.columns + first) : Lanes(at); }
    Lanes law(int i) const { return seeded(of.law_[i], of.d_law_ + i * of.r_.columns + first); }
    Lanes anchor(int i) const { return some(of.before().anchor, of.before().d_anchor, 3 * k + i); }
    double measured(double at) const { return at; }
    Lanes load() const { return some(of.before().load, of.before().d_load, k); }
    Lanes speed() const { return some(of.before().speed, of.before().d_speed, k); }
    Lanes some(const std::vector<double> &v, const std::vector<double> &d, int n) const {
      return seeded(v[n], &d[n * of.r_.columns + first]);
    }
  };

  bool acts(int k) const { return own().step_.limit[k] > 0.0 || own().step_.now.gap[k] < law_[Of::reach]; }
  View<const double, 2> rows(const double *x) const { return {x, r_.nodes, 3}; }
  View<const double, 1> law() const { return {law_.data(), 8}; }
  View<const double, 2> anchor() const { return {own().before().anchor.data(), own().count(), 3}; }

  // Bring the gaps up to date with the positions; false when there is nothing to touch.
  bool look(const double *x) {
    if (!own().any()) return false;
    if (seen_.empty() || !std::equal(seen_.begin(), seen_.end(), x)) {
      own().measure(x);
      seen_.assign(x, x + 3 * r_.nodes);
    }
    return true;
  }

  const Record &r_;
  double margin_;
  std::vector<double> law_;
  const double *d_law_, *x_start_ = nullptr;
  AddedLaws added_;
  Candidates candidates_;
  std::vector<double> seen_;  // positions of the gaps

 private:
  Of &own() { return static_cast<Of &>(*this); }
  const Of &own() const { return static_cast<const Of &>(*this); }
};

}  // namespace thinshell
