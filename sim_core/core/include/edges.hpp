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

class EdgePairs : public Frictional<EdgePairs> {
 public:
  EdgePairs(const Record &record, int which)
      : Frictional(record, record.edge_margin[which], record.edge_law + 8 * which,
                   record.d_edge_law + 8 * which * record.columns, record.contacts + record.surfaces + which,
                   edges(record, 2 * which), edges(record, 2 * which + 1), record.edge_once[which],
                   [this](const double *x, int i, int j) { return distance(x, i, j); }),
        ours_(r_.edge_start[2 * which]), theirs_(r_.edge_start[2 * which + 1]), step_(0, nullptr, nullptr, nullptr, nullptr) {}

  Keys keys;  // of the pairs that are remembered

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

  // As of all, and of which pairs.
  void end(const double *x, double dt) {
    Frictional::end(x, dt);
    keys = candidates_.inner();
  }

 private:
  friend class Frictional<EdgePairs>;
  template <class> friend struct Pull;
  template <class> friend struct PullPoints;
  static constexpr int reach = RANGE;

  // Squared sine below which the energy of two edges fades (PARALLEL of sim_core/contact/segments.py).
  static constexpr double parallel_edges = 1e-3;

  // One pair of numbers with derivatives: forces on its ends, and its load.
  template <class Given> struct One {
    using S = typename Given::S;
    using A = typename Given::A;
    const EdgePairs &of;
    int pair, ends[4] = {0, 1, 2, 3};
    A area, parallel;
    S x[12], x_start[12], out[12], law[8], anchor[3];
    EdgeStep<S, A> step;

    One(const EdgePairs &pairs, int k, const double *at, const Given &given)
        : of(pairs), pair(k), area(given.measured(of.area_[k])), parallel(given.measured(of.parallel_[k])),
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
    int node(std::size_t n) const { return of.step_.ends(pair, n); }

   private:
    View<S, 2> places() { return {x, 4, 3}; }
    View<S, 2> starts() { return {x_start, 4, 3}; }
    View<S, 1> numbers() { return {law, 8}; }
    View<S, 2> remembered() { return {anchor, 1, 3}; }
  };

  static Primitives edges(const Record &r, int side) {
    return {r.edge_node + 2 * r.edge_start[side], nullptr, int(r.edge_start[side + 1] - r.edge_start[side]), 2};
  }
  const int32_t *edge(int64_t i) const { return r_.edge_node + 2 * i; }
  // Our edge and theirs of a pair.
  std::pair<int64_t, int64_t> edges_of(int64_t key) const {
    return {ours_ + candidates_.first(key), theirs_ + candidates_.second(key)};
  }
  int count() const { return step_.count; }
  const Held &before() const { return start_; }
  double spring(int k) const { return step_.spring[k]; }
  bool any() const { return count() > 0; }
  void measure(const double *x) { step_.measure(step_.now, rows(x), law()); }

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

  int64_t ours_, theirs_;
  std::vector<int> ends_;
  std::vector<double> area_, parallel_, side_;
  Held start_;
  EdgeStep<double> step_;
};

}  // namespace thinshell
