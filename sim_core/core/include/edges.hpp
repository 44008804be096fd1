// Contact of the edges of two surfaces, or of one with itself (sim_core/contact/edges.py).
//
// The kernels of sim_core/contact/edge_kernels.py are run as they are, lowered, over all pairs of edges that are near;
// derivatives by parameters are those of the same kernels run with dual numbers over one pair at a time. What a pair
// remembers is found again by its key when the candidates change.
#pragma once

#include "surfaces.hpp"

namespace thinshell {

// Where pairs of edges are nearest, as the kernel `measure` writes it.
template <class S> struct Crossing {
  int count;
  std::vector<S> at, direction, sign, fade, gap;

  explicit Crossing(int pairs)
      : count(pairs), at(2 * pairs, S(0.0)), direction(3 * pairs, S(0.0)), sign(pairs, S(1.0)), fade(2 * pairs, S(0.0)),
        gap(pairs, S(nowhere)) {}
  View<S, 2> ats() { return {at.data(), count, 2}; }
  View<S, 2> directions() { return {direction.data(), count, 3}; }
  View<S, 1> signs() { return {sign.data(), count}; }
  View<S, 2> fades() { return {fade.data(), count, 2}; }
  View<S, 1> gaps() { return {gap.data(), count}; }
};

// Some pairs of edges: their tables, and what the kernels write of them; A: of what is measured at rest.
template <class S, class A = double> struct EdgeStep {
  int count;
  View<const int, 2> ends;
  View<const A, 1> areas, parallel;
  View<const double, 1> side;
  Crossing<S> now, lag;
  std::vector<S> limit, spring, frame, load;

  EdgeStep(int pairs, const int *ends_, const A *areas_, const A *parallel_, const double *side_)
      : count(pairs), ends(ends_, pairs, 4), areas(areas_, pairs), parallel(parallel_, pairs), side(side_, pairs),
        now(pairs), lag(pairs), limit(pairs, S(0.0)), spring(pairs, S(0.0)), frame(36 * pairs, S(0.0)), load(pairs, S(0.0)) {}

  View<const int, 1> counted() const { return {&count, 1}; }
  View<S, 2> frames() { return {frame.data(), count, 36}; }
  View<S, 1> limits() { return {limit.data(), count}; }
  View<S, 1> springs() { return {spring.data(), count}; }

  template <class X, class L> void measure(Crossing<S> &to, X x, L law) {
    laws::edge_kernels::measure(x, counted(), ends, parallel, side, law, to.ats(), to.directions(), to.signs(), to.fades(),
                                to.gaps());
  }
  template <class X> void make_frames(X x_start) {
    laws::edge_kernels::frames(x_start, counted(), ends, lag.ats(), frames());
  }
  template <class X, class Y, class L, class H, class O> void add_gradient(X x, Y x_start, L law, H anchor, O out) {
    S first[4 * 3], second[16 * 9];
    laws::edge_kernels::add_gradient(x, x_start, counted(), ends, areas, law, limits(), springs(), frames(),
                                     lag.directions(), anchor, now.fades(), now.gaps(), now.ats(), now.directions(),
                                     View<S, 1>(load.data(), count), View<S, 2>(first, 4, 3), View<S, 3>(second, 16, 3, 3), out);
  }
  // Elastic slip before it slides.
  template <class X, class Y, class H> Vec<S, 3> slip(X x, Y x_start, H anchor, int k) {
    return laws::edge_kernels::_elastic_slip(x, x_start, ends, frames(), lag.directions(), anchor, k).a0;
  }
};

class EdgePairs {
 public:
  EdgePairs(const Record &record, int which)
      : r_(record), ours_(r_.edge_start[2 * which]), theirs_(r_.edge_start[2 * which + 1]), once_(r_.edge_once[which]),
        counts_{r_.edge_start[2 * which + 1] - ours_, r_.edge_start[2 * which + 2] - theirs_},
        margin_(r_.edge_margin[which]), law_(r_.edge_law + 8 * which, r_.edge_law + 8 * which + 8),
        d_law_(r_.d_edge_law + 8 * which * r_.columns), added_(r_, r_.contacts + r_.surfaces + which), step_(0, nullptr, nullptr, nullptr, nullptr),
        candidates_(Primitives(edge(ours_), nullptr, counts_[0], 2), Primitives(edge(theirs_), nullptr, counts_[1], 2),
                    once_, [this](const double *x, int i, int j) { return distance(x, i, j); }) {}
  EdgePairs(const EdgePairs &) = delete;

  // What the pairs `keys` remember.
  Held held;
  Keys keys;

  void guard(bool on) {
    set_guard(law_.data(), on);
    seen_.clear();
  }

  // As of Surface.
  bool prepare(const double *x, const double *towards, bool more) {
    const auto changed = candidates_.search(x, towards, 3 * r_.nodes, law_[OFFSET] + law_[RANGE], margin_, more);
    if (changed.inner) list();
    return changed.outer;
  }
  void recouple(const double *x, const double *towards) { candidates_.recouple(x, towards); }
  bool outran(const double *x) const { return candidates_.outran(x); }

  void couple(std::vector<PairTable::Pair> &pairs) const {
    for (int64_t key : candidates_.coupled()) {
      const int32_t *p = edge(ours_ + candidates_.first(key)), *q = edge(theirs_ + candidates_.second(key));
      const int ends[4] = {p[0], p[1], q[0], q[1]};
      for (int a = 0; a < 4; ++a)
        for (int b = a; b < 4; ++b) pairs.push_back({ends[a], ends[b]});
    }
  }

  void begin(const double *x_start) {
    x_start_ = x_start;
    seen_.clear();
    if (!count()) return;
    remember();
    laws::edge_kernels::sides(rows(x_start), step_.counted(), step_.ends, View<double, 1>(side_.data(), side_.size()));
    step_.measure(step_.lag, rows(x_start), law());
    step_.make_frames(rows(x_start));
    for (int k = 0; k < count(); ++k) {
      step_.limit[k] = added_.bound(law_[MU], start_.load[k], area_[k], start_.speed[k], 0);
      step_.spring[k] = law_[STIFFNESS] * area_[k] * step_.lag.fade[2 * k];
    }
  }

  void add_energy(const double *x, double *out) {
    if (!look(x)) return;
    laws::edge_kernels::add_energy(rows(x), rows(x_start_), step_.counted(), step_.ends, step_.areas, law(), step_.limits(),
                                   step_.springs(), step_.frames(), step_.lag.directions(), anchor(), step_.now.fades(),
                                   step_.now.gaps(), View<double, 1>(out, 1));
  }
  void add_gradient(const double *x, double *out) {
    if (look(x)) step_.add_gradient(rows(x), rows(x_start_), law(), anchor(), View<double, 2>(out, r_.nodes, 3));
  }
  void add_hessian(const double *x, bool exact, PairTable &table) {
    if (!look(x)) return;
    const int with[1] = {exact};
    double first[4 * 3], second[16 * 9], curved[16 * 9];
    laws::edge_kernels::add_hessian(
        rows(x), rows(x_start_), step_.counted(), step_.ends, step_.areas, law(), step_.limits(), step_.springs(),
        step_.frames(), step_.lag.directions(), anchor(), step_.now.fades(), step_.now.gaps(), step_.now.ats(),
        step_.now.directions(), step_.now.signs(), step_.parallel, View<const int, 1>(with, 1), table.start(),
        table.column(), table.place(), View<double, 2>(first, 4, 3), View<double, 3>(second, 16, 3, 3),
        View<double, 3>(curved, 16, 3, 3), table.values());
  }

  double free_way(const double *x, const double *move, double keep) const {
    double way = 1.0;
    if (count())
      laws::edge_kernels::free_way(rows(x), rows(move), step_.counted(), step_.ends, law(), View<const double, 1>(&keep, 1),
                                   View<double, 1>(&way, 1));
    return way;
  }

  // Memory after the step that ended at `x`, from forces that were evaluated last.
  void end(const double *x, double dt) {
    Held after;
    after.resize(count(), 0);
    const bool any = look(x);
    for (int k = 0; any && k < count(); ++k) {
      if (!(step_.load[k] > 0.0)) continue;
      const Vec3 kept = kept_slip(step_.slip(rows(x), rows(x_start_), anchor(), k), step_.limit[k], step_.spring[k], dt, after.speed[k]);
      std::copy(kept.a, kept.a + 3, &after.anchor[3 * k]);
      after.load[k] = step_.load[k];
    }
    after.d_anchor.swap(held.d_anchor);
    after.d_load.swap(held.d_load);
    after.d_speed.swap(held.d_speed);
    held = std::move(after);
    keys = candidates_.inner();
  }

  // As of Surface.
  void add_columns(const double *x, const double *dx_start, double *out) {
    if (!look(x)) return;
    for (int k = 0; k < count(); ++k)
      if (acts(k))
        for (int first = 0; first < r_.columns; first += lanes) {
          One<InColumns> one(*this, k, x, {*this, k, first, dx_start, nullptr});
          for (int a = 0; a < 4; ++a) scatter(&one.out[3 * a], 3, out + 3 * step_.ends(k, a) * r_.columns, r_.columns, first);
        }
  }
  void end_columns(const double *x, const double *dx_start, const double *dx, double dt) {
    Held after;
    after.resize(count(), r_.columns);
    const bool any = look(x);
    for (int k = 0; any && k < count(); ++k)
      if (step_.load[k] > 0.0)
        for (int first = 0; first < r_.columns; first += lanes) {
          One<InColumns> one(*this, k, x, {*this, k, first, dx_start, dx});
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

  bool acts() const {
    for (int k = 0; k < count(); ++k)
      if (acts(k)) return true;
    return false;
  }
  std::pair<int64_t, double> report() const {
    int64_t loaded = 0;
    double smallest = nowhere;
    for (int k = 0; k < count(); ++k) {
      loaded += step_.load[k] > 0.0;
      smallest = std::min(smallest, step_.now.gap[k]);
    }
    return {loaded, smallest};
  }

 private:
  template <class> friend struct Pull;
  template <class> friend struct PullPoints;

  // Squared sine below which the energy of two edges fades (PARALLEL of sim_core/contact/segments.py).
  static constexpr double parallel_edges = 1e-3;

  // Numbers of one pair with their derivatives in some columns, as of Surface.
  struct InColumns {
    using S = Lanes;
    using A = double;
    const EdgePairs &of;
    int k, first;
    const double *dx_start, *dx;
    Lanes start(std::size_t n) const { return seeded(of.x_start_[n], dx_start + n * of.r_.columns + first); }
    Lanes end(std::size_t n, double at) const { return dx ? seeded(at, dx + n * of.r_.columns + first) : Lanes(at); }
    Lanes law(int i) const { return seeded(of.law_[i], of.d_law_ + i * of.r_.columns + first); }
    Lanes anchor(int i) const { return some(of.start_.anchor, of.start_.d_anchor, 3 * k + i); }
    double measured(double at) const { return at; }
    Lanes load() const { return some(of.start_.load, of.start_.d_load, k); }
    Lanes speed() const { return some(of.start_.speed, of.start_.d_speed, k); }
    Lanes some(const std::vector<double> &v, const std::vector<double> &d, int n) const {
      return seeded(v[n], &d[n * of.r_.columns + first]);
    }
  };

  // One pair of numbers with derivatives: forces on its ends, and its load.
  template <class Given> struct One {
    using S = typename Given::S;
    using A = typename Given::A;
    const EdgePairs &of;
    int ends[4] = {0, 1, 2, 3};
    A area, parallel;
    S x[12], x_start[12], out[12], law[8], anchor[3];
    EdgeStep<S, A> step;

    One(const EdgePairs &pairs, int k, const double *at, const Given &given)
        : of(pairs), area(given.measured(of.area_[k])), parallel(given.measured(of.parallel_[k])),
          step(1, ends, &area, &parallel, &of.side_[k]) {
      for (int a = 0; a < 4; ++a)
        for (int i = 0; i < 3; ++i) {
          const std::size_t n = 3 * std::size_t(of.step_.ends(k, a)) + i;
          x_start[3 * a + i] = given.start(n);
          x[3 * a + i] = given.end(n, at[n]);
        }
      for (int i = 0; i < 8; ++i) law[i] = given.law(i);
      for (int i = 0; i < 3; ++i) anchor[i] = given.anchor(i);
      step.measure(step.lag, starts(), numbers());
      step.measure(step.now, places(), numbers());
      step.make_frames(starts());
      step.limit[0] = of.added_.bound(law[MU], given.load(), area, given.speed(), given.first);
      step.spring[0] = law[STIFFNESS] * area * step.lag.fade[0];
      step.add_gradient(places(), starts(), numbers(), remembered(), View<S, 2>(out, 4, 3));
    }
    Vec<S, 3> slide(double dt, S &speed) {
      return kept_slip(step.slip(places(), starts(), remembered(), 0), step.limit[0], step.spring[0], dt, speed);
    }

   private:
    View<S, 2> places() { return {x, 4, 3}; }
    View<S, 2> starts() { return {x_start, 4, 3}; }
    View<S, 1> numbers() { return {law, 8}; }
    View<S, 2> remembered() { return {anchor, 1, 3}; }
  };

  const int32_t *edge(int64_t i) const { return r_.edge_node + 2 * i; }
  // Our edge and theirs of a pair.
  std::pair<int64_t, int64_t> edges_of(int64_t key) const {
    return {ours_ + candidates_.first(key), theirs_ + candidates_.second(key)};
  }
  int count() const { return step_.count; }
  bool acts(int k) const { return step_.limit[k] > 0.0 || step_.now.gap[k] < law_[RANGE]; }
  View<const double, 2> rows(const double *x) const { return {x, r_.nodes, 3}; }
  View<const double, 1> law() const { return {law_.data(), 8}; }
  View<const double, 2> anchor() const { return {start_.anchor.data(), count(), 3}; }

  double distance(const double *x, int i, int j) const {
    const int32_t *p = edge(ours_ + i), *q = edge(theirs_ + j);
    const Vec3 p0 = point(x, p[0]), p1 = point(x, p[1]), q0 = point(x, q[0]), q1 = point(x, q[1]);
    const auto at = laws::segments::closest_on_segments(p0, p1, q0, q1);
    return Vec3(p0 + at.a0 * (p1 - p0) - q0 - at.a1 * (q1 - q0)).norm();
  }

  // Tables of the pairs that were found.
  void list() {
    ends_.clear();
    area_.clear();
    parallel_.clear();
    for (int64_t key : candidates_.inner()) {
      const auto [i, j] = edges_of(key);
      for (const int32_t *e : {edge(i), edge(j)}) ends_.insert(ends_.end(), e, e + 2);
      area_.push_back(r_.edge_area[j] < 0.0 ? r_.edge_area[i] : 0.5 * (r_.edge_area[i] + r_.edge_area[j]));
      parallel_.push_back(parallel_edges * r_.edge_square[i] * r_.edge_square[j]);
    }
    side_.assign(area_.size(), 1.0);
    step_ = EdgeStep<double>(int(area_.size()), ends_.data(), area_.data(), parallel_.data(), side_.data());
  }

  // What the candidates remember, zero where they were none.
  void remember() {
    start_.resize(count(), r_.columns);
    const Keys &now = candidates_.inner();
    for (std::size_t k = 0, old = 0; k < now.size(); ++k) {
      while (old < keys.size() && keys[old] < now[k]) ++old;
      if (old < keys.size() && keys[old] == now[k]) start_.take(int(k), held, int(old), r_.columns);
    }
  }

  bool look(const double *x) {
    if (!count()) return false;
    if (seen_.empty() || !std::equal(seen_.begin(), seen_.end(), x)) {
      step_.measure(step_.now, rows(x), law());
      seen_.assign(x, x + 3 * r_.nodes);
    }
    return true;
  }

  const Record &r_;
  int64_t ours_, theirs_;
  bool once_;
  int counts_[2];
  double margin_;
  std::vector<double> law_;
  const double *d_law_, *x_start_ = nullptr;
  AddedLaws added_;
  std::vector<int> ends_;
  std::vector<double> area_, parallel_, side_, seen_;
  Held start_;
  EdgeStep<double> step_;
  Candidates candidates_;
};

}  // namespace thinshell
