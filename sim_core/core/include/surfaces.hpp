// Contact of the samples of one surface with the triangles of another, or of its own (sim_core/contact/surface.py).
//
// The kernels of sim_core/contact/surface_kernels.py and surface_geometry.py are run as they are, lowered, over all
// samples; derivatives by parameters are those of the same kernels run with dual numbers over one sample at a time.
#pragma once

#include <set>
#include <vector>

#include "frictional.hpp"

namespace thinshell {

// Where samples are nearest to triangles, as the kernel `measure` writes it.
template <class S> struct Nearest {
  static constexpr int most = 12;  // triangles that may share in a gap (MOST of surface_kernels.py)
  int count;
  std::vector<int> number, triangle, kind;
  std::vector<S> weight, direction, share, distance, sign, gap;

  explicit Nearest(int samples) : count(samples), number(samples, 0) {
    triangle.assign(most * samples, 0);
    kind.assign(most * samples, 0);
    weight.assign(3 * most * samples, S(0.0));
    direction = weight;
    share.assign(most * samples, S(0.0));
    distance = share;
    sign.assign(samples, S(1.0));
    gap.assign(samples, S(nowhere));
  }
  View<int, 1> numbers() { return {number.data(), count}; }
  View<int, 2> triangles() { return {triangle.data(), count, most}; }
  View<int, 2> kinds() { return {kind.data(), count, most}; }
  View<S, 2> weights() { return {weight.data(), count, 3 * most}; }
  View<S, 2> directions() { return {direction.data(), count, 3 * most}; }
  View<S, 2> shares() { return {share.data(), count, most}; }
  View<S, 2> distances() { return {distance.data(), count, most}; }
  View<S, 1> signs() { return {sign.data(), count}; }
  View<S, 1> gaps() { return {gap.data(), count}; }
};

// Some samples over triangles: their tables, and what the kernels write of them; A: of their areas.
template <class S, class A = double> struct SampleStep {
  View<const int, 2> own;
  View<const int, 1> used;
  View<const double, 2> weights;
  View<const int, 2> triangles, border;
  View<const A, 1> areas;
  int count;
  Nearest<S> now, lag;
  std::vector<S> limit, frame, force, load;
  std::vector<S> added;  // energy, pressure and slope by effects

  SampleStep(View<const int, 2> own_, View<const int, 1> used_, View<const double, 2> weights_,
             View<const int, 2> triangles_, View<const int, 2> border_, View<const A, 1> areas_)
      : own(own_), used(used_), weights(weights_), triangles(triangles_), border(border_), areas(areas_),
        count(own_.shape[0]), now(count), lag(count) {
    limit.assign(count, S(0.0));
    load = limit;
    frame.assign(27 * count, S(0.0));
    force.assign(3 * count, S(0.0));
    added.assign(3 * count, S(0.0));
  }
  View<S, 2> frames() { return {frame.data(), count, 27}; }
  View<const S, 2> added_pressures() const { return {added.data(), count, 3}; }

  template <class X, class L>
  void measure(Nearest<S> &to, X x, View<const int, 1> first, View<const int, 1> near, View<const double, 2> normals,
               View<const double, 1> side, L law) {
    laws::surface_kernels::measure(x, own, used, weights, triangles, border, first, near, normals, side, law, to.numbers(),
                                   to.triangles(), to.weights(), to.directions(), to.shares(), to.kinds(), to.distances(),
                                   to.signs(), to.gaps());
  }
  template <class X> void make_frames(X x_start) {
    laws::surface_geometry::frames(x_start, own, used, weights, triangles, lag.numbers(), lag.triangles(), frames());
  }
  template <class X, class Y, class L, class H, class O> void add_gradient(X x, Y x_start, L law, H anchor, O out) {
    laws::surface_kernels::add_gradient(
        x, x_start, own, used, weights, triangles, areas, law, View<S, 1>(limit.data(), count), lag.triangles(), frames(),
        lag.directions(), anchor, now.gaps(), added_pressures(), now.numbers(), now.triangles(), now.weights(), now.directions(),
        now.shares(), View<S, 2>(force.data(), count, 3), View<S, 1>(load.data(), count), out);
  }
  // Elastic slip before it slides.
  template <class X, class Y, class H> Vec<S, 3> slip(X x, Y x_start, H anchor, int s) {
    return laws::surface_kernels::_elastic_slip(x, x_start, own, used, weights, triangles, lag.triangles(), frames(),
                                                lag.directions(), anchor, s)
        .a0;
  }
};

class Surface : public Frictional<Surface> {
 public:
  Surface(const Record &record, int which)
      : Frictional(record, record.surface_margin[which], record.surface_law + 8 * which,
                   record.d_surface_law + 8 * which * record.columns, record.contacts + which,
                   samples(record, which), triangles(record, which), false,
                   [this](const double *x, int s, int t) { return distance(x, s, t); }),
        first_sample_(r_.surface_sample_start[which]), first_triangle_(r_.surface_triangle_start[which]),
        samples_(r_.surface_sample_start[which + 1] - first_sample_),
        triangles_(r_.surface_triangle_start[which + 1] - first_triangle_), corners_(int(r_.surface_corners)),
        step_({own(), samples_, corners_}, {r_.surface_used + first_sample_, samples_}, {weights(), samples_, corners_},
              {triangle(0), triangles_, 3}, {r_.surface_border + 6 * first_triangle_, triangles_, 6},
              {r_.surface_area + first_sample_, samples_}) {
    held.resize(samples_, r_.columns);
    first_.assign(samples_ + 1, 0);
    normals_.assign(3 * r_.nodes, 0.0);
  }

  // Pairs of the samples' nodes and of the corners of all triangles in the wider search, and of the corners of triangles
  // around one node, which may share in a gap.
  void couple(std::vector<PairTable::Pair> &pairs) const {
    std::set<int> near, members;
    for (int64_t key : candidates_.coupled()) {
      const int s = candidates_.first(key), t = candidates_.second(key);
      near.insert(t);
      members.insert(s);
      for (int a = 0; a < corners_; ++a)
        for (int k = 0; k < 3; ++k) pairs.push_back({own()[s * corners_ + a], triangle(t)[k]});
    }
    for (int s : members)
      for (int a = 0; a < corners_; ++a)
        for (int b = a; b < corners_; ++b) pairs.push_back({own()[s * corners_ + a], own()[s * corners_ + b]});
    std::vector<std::vector<int>> around(near.empty() ? 0 : r_.nodes);
    for (int t : near)
      for (int k = 0; k < 3; ++k)
        for (int m = 0; m < 3; ++m) around[triangle(t)[k]].push_back(triangle(t)[m]);
    for (auto &star : around) {
      std::sort(star.begin(), star.end());
      star.erase(std::unique(star.begin(), star.end()), star.end());
      for (std::size_t a = 0; a < star.size(); ++a)
        for (std::size_t b = a; b < star.size(); ++b) pairs.push_back({star[a], star[b]});
    }
  }

  void begin(const double *x_start) {
    x_start_ = x_start;
    seen_.clear();
    auto &limit = step_.limit;
    std::fill(limit.begin(), limit.end(), 0.0);
    std::fill(step_.load.begin(), step_.load.end(), 0.0);
    if (near_.empty()) {
      std::fill(step_.now.gap.begin(), step_.now.gap.end(), nowhere);
      return;
    }
    laws::surface_geometry::sides(rows(x_start), step_.own, step_.used, step_.weights, step_.triangles, first(), near(),
                                  View<double, 2>(normals_.data(), r_.nodes, 3), View<double, 1>(side_.data(), near_.size()));
    step_.measure(step_.lag, rows(x_start), first(), near(), normals(), side(), law());
    step_.make_frames(rows(x_start));
    for (int s = 0; s < samples_; ++s)
      if (step_.lag.number[s] > 0) limit[s] = added_.bound(law_[MU], held.load[s], step_.areas[s], held.speed[s], 0);
  }

  void add_energy(const double *x, double *out) {
    if (!look(x)) return;
    laws::surface_kernels::add_energy(rows(x), rows(x_start_), step_.own, step_.used, step_.weights, step_.triangles,
                                      step_.areas, law(), limits(), step_.lag.triangles(), step_.frames(),
                                      step_.lag.directions(), anchor(), step_.now.gaps(), step_.added_pressures(),
                                      View<double, 1>(out, 1));
  }
  void add_gradient(const double *x, double *out) {
    if (look(x)) step_.add_gradient(rows(x), rows(x_start_), law(), anchor(), View<double, 2>(out, r_.nodes, 3));
  }
  void add_hessian(const double *x, bool exact, PairTable &table) {
    if (!look(x)) return;
    auto &now = step_.now;
    const int participants = corners_ + 3 * now.most, with[1] = {exact};
    slopes_.resize(3 * participants * (now.most + 2));
    double second[16 * 9];
    laws::surface_kernels::add_hessian(
        rows(x), rows(x_start_), step_.own, step_.used, step_.weights, step_.triangles, step_.areas, law(), limits(),
        step_.lag.triangles(), step_.frames(), step_.lag.directions(), anchor(), now.gaps(), step_.added_pressures(), now.numbers(),
        now.triangles(), now.weights(), now.directions(), now.shares(), now.kinds(), now.signs(),
        View<const int, 1>(with, 1), table.start(), table.column(), table.place(),
        View<double, 3>(slopes_.data(), now.most + 2, participants, 3), View<double, 3>(second, 16, 3, 3), table.values());
  }

  double free_way(const double *x, const double *move, double keep) const {
    double way = 1.0;
    if (!near_.empty())
      laws::surface_geometry::free_way(rows(x), rows(move), step_.own, step_.used, step_.weights, step_.triangles, first(),
                                       near(), law(), View<const double, 1>(&keep, 1), View<double, 1>(&way, 1));
    return way;
  }

 private:
  friend class Frictional<Surface>;
  template <class> friend struct Pull;
  template <class> friend struct PullPoints;
  static constexpr int reach = REACH;

  // One sample with what it meets, of numbers with derivatives: forces on its nodes, and its load.
  template <class Given> struct One {
    using S = typename Given::S;
    using A = typename Given::A;
    const Surface &of;
    int s;
    std::vector<int> own, triangles, border, nodes;
    int used, corners;
    A area;
    std::vector<S> x, x_start, out;
    S law[8], anchor[3];
    SampleStep<S, A> step;

    One(const Surface &surface, int sample, const double *at, const Given &given)
        : of(surface), s(sample), nodes(members()), used(of.step_.used[s]), corners(of.corners_), area(given.measured(of.step_.areas[s])),
          step({own.data(), 1, corners}, {&used, 1}, {of.weights() + s * corners, 1, corners},
               {triangles.data(), triangles.size() / 3, 3}, {border.data(), triangles.size() / 3, 6}, {&area, 1}) {
      for (int node : nodes)
        for (int i = 0; i < 3; ++i) {
          const std::size_t k = 3 * std::size_t(node) + i;
          x_start.push_back(given.start(k));
          x.push_back(given.end(k, at[k]));
        }
      for (int k = 0; k < 8; ++k) law[k] = given.law(k);
      for (int i = 0; i < 3; ++i) anchor[i] = given.anchor(i);
      // Candidates: those that share in the gap now, the nearest first, then the one that was nearest at the start.
      const int now = of.step_.now.number[s];
      std::vector<int> near(now + 1);
      for (int k = 0; k <= now; ++k) near[k] = k;
      const std::vector<double> nothing(3 * nodes.size(), 0.0), side(now + 1, 1.0);
      const View<const double, 2> normals(nothing.data(), nodes.size(), 3);
      const View<const double, 1> sides(side.data(), side.size());
      const View<const int, 1> all(near.data(), near.size());
      const int here[2] = {0, now}, before[2] = {now, now + 1};
      step.measure(step.lag, starts(), View<const int, 1>(before, 2), all, normals, sides, numbers());
      step.measure(step.now, places(), View<const int, 1>(here, 2), all, normals, sides, numbers());
      step.make_frames(starts());
      if (of.step_.limit[s] > 0.0)
        step.limit[0] = of.added_.bound(law[MU], given.load(), area, given.speed(), given.first);
      if (value(step.now.gap[0]) < of.law_[REACH]) step.added[1] = of.added_.pressure(step.now.gap[0], 1.0, given.first);
      out.assign(3 * nodes.size(), S(0.0));
      step.add_gradient(places(), starts(), numbers(), remembered(), View<S, 2>(out.data(), nodes.size(), 3));
    }

    Vec<S, 3> slide(double dt, S &speed) {
      return kept_slip(step.slip(places(), starts(), remembered(), 0), step.limit[0], S(law[STIFFNESS] * area), dt, speed);
    }
    int node(std::size_t n) const { return nodes[n]; }

   private:
    View<S, 2> places() { return {x.data(), nodes.size(), 3}; }
    View<S, 2> starts() { return {x_start.data(), nodes.size(), 3}; }
    View<S, 1> numbers() { return {law, 8}; }
    View<S, 2> remembered() { return {anchor, 1, 3}; }

    // Own nodes and the corners of the triangles, each once, and the tables in their numbers.
    std::vector<int> members() {
      std::vector<int> found;
      auto number = [&](int node) {
        const int at = int(std::find(found.begin(), found.end(), node) - found.begin());
        if (at == int(found.size())) found.push_back(node);
        return at;
      };
      for (int a = 0; a < of.corners_; ++a) own.push_back(number(of.own()[s * of.corners_ + a]));
      const auto &now = of.step_.now;
      for (int k = 0; k <= now.number[s]; ++k) {
        const int t = k < now.number[s] ? now.triangle[now.most * s + k] : of.step_.lag.triangle[now.most * s];
        for (int j = 0; j < 3; ++j) triangles.push_back(number(of.triangle(t)[j]));
        for (int j = 0; j < 6; ++j) border.push_back(of.step_.border(t, j));
      }
      return found;
    }
  };

  static Primitives samples(const Record &r, int which) {
    const int64_t first = r.surface_sample_start[which], corners = r.surface_corners;
    return {r.surface_node + first * corners, r.surface_weight + first * corners,
            int(r.surface_sample_start[which + 1] - first), int(corners)};
  }
  static Primitives triangles(const Record &r, int which) {
    const int64_t first = r.surface_triangle_start[which];
    return {r.surface_triangle + 3 * first, nullptr, int(r.surface_triangle_start[which + 1] - first), 3};
  }
  const int32_t *own() const { return r_.surface_node + first_sample_ * corners_; }
  const double *weights() const { return r_.surface_weight + first_sample_ * corners_; }
  const int32_t *triangle(int t) const { return r_.surface_triangle + 3 * (first_triangle_ + t); }
  int count() const { return samples_; }
  const Held &before() const { return held; }
  double spring(int s) const { return law_[STIFFNESS] * step_.areas[s]; }
  bool any() const { return !near_.empty(); }

  View<const int, 1> first() const { return {first_.data(), first_.size()}; }
  View<const int, 1> near() const { return {near_.data(), near_.size()}; }
  View<const double, 2> normals() const { return {normals_.data(), r_.nodes, 3}; }
  View<const double, 1> side() const { return {side_.data(), side_.size()}; }
  View<const double, 1> limits() const { return {step_.limit.data(), samples_}; }

  double distance(const double *x, int s, int t) const {
    const Vec3 p = laws::surface_geometry::sample_at(rows(x), step_.own, step_.used, step_.weights, s);
    return laws::surface_geometry::closest_on(rows(x), p, step_.triangles, t).a2.norm();
  }

  // Triangles near each sample.
  void list() {
    near_.clear();
    first_.assign(samples_ + 1, 0);
    for (int64_t key : candidates_.inner()) {
      near_.push_back(candidates_.second(key));
      ++first_[candidates_.first(key) + 1];
    }
    for (int s = 0; s < samples_; ++s) first_[s + 1] += first_[s];
    side_.assign(near_.size(), 1.0);
  }

  void measure(const double *x) {
    step_.measure(step_.now, rows(x), first(), near(), normals(), side(), law());
    for (int s = 0; added_.presses() && s < samples_; ++s) {
      const double gap = step_.now.gap[s];
      const auto at = gap < law_[REACH] ? added_.normal(gap, 1.0) : AddedLaws::Normal{};
      step_.added[3 * s] = at.energy;
      step_.added[3 * s + 1] = at.pressure;
      step_.added[3 * s + 2] = at.slope;
    }
  }

  int64_t first_sample_, first_triangle_;
  int samples_, triangles_, corners_;
  SampleStep<double> step_;
  std::vector<int> first_, near_;
  std::vector<double> side_, normals_, slopes_;
};

}  // namespace thinshell
