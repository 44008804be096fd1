// Numbers that note how they came about, for derivatives of a few results by everything at once (reverse mode).
//
// Each operation leaves a node with the places of its operands and the derivatives by them; a sweep from the last node to
// the first adds up the derivatives of a sum of results by all nodes (Griewank & Walther, Evaluating Derivatives, 2nd ed.,
// 2008, ch. 3.2). The operations are those of dual numbers (dual.hpp), whose two rules of the chain are all that differs.
#pragma once

#include <vector>

#include "dual.hpp"

namespace thinshell {

class Trace {
 public:
  // What numbers are noted on now, in this thread.
  static Trace *&active() {
    static thread_local Trace *now __attribute__((tls_model("initial-exec"))) = nullptr;
    return now;
  }
  // Numbers are noted on a trace as long as one of these lives.
  struct Scope {
    Trace *before;
    explicit Scope(Trace &trace) : before(active()) { active() = &trace; }
    Scope(const Scope &) = delete;
    ~Scope() { active() = before; }
  };

  void clear() {
    nodes_.assign(1, Node{0, 0, 0.0, 0.0});  // stands for all that is constant
    weight_.clear();
  }
  int size() const { return int(nodes_.size()); }
  int add(int a, double by_a, int b, double by_b) {
    nodes_.push_back({a, b, by_a, by_b});
    return size() - 1;
  }
  int variable() { return add(0, 0.0, 0, 0.0); }

  // Weights of nodes: derivatives of the sum by them, after `sweep`.
  double &weight(int at) {
    if (weight_.size() < nodes_.size()) weight_.resize(nodes_.size(), 0.0);
    return weight_[at];
  }
  // Pass the weights of the nodes from `first` on, before `last`, on to their operands.
  void sweep(int first, int last) {
    weight(0);
    for (int k = last - 1; k >= first; --k) {
      const double w = weight_[k];
      if (w == 0.0) continue;
      weight_[nodes_[k].a] += nodes_[k].by_a * w;
      weight_[nodes_[k].b] += nodes_[k].by_b * w;
    }
  }
  // Let those of some nodes be zero.
  void forget(int first, int last) {
    weight(0);
    std::fill(weight_.begin() + first, weight_.begin() + last, 0.0);
  }

 private:
  struct Node {
    int a, b;
    double by_a, by_b;
  };
  std::vector<Node> nodes_;
  std::vector<double> weight_;
};

// `at`: place on the trace, 0: constant. N has no meaning.
template <class T, int N> struct Traced {
  using Scalar = Traced;
  T v;
  int at;
  Traced() : v(0), at(0) {}
  Traced(T value) : v(value), at(0) {}
  template <class U, class = typename EnableIf<is_number<U> && !Same<U, T>::value>::type> Traced(U value) : v(T(value)), at(0) {}
  static Traced variable(T value) {
    Traced out(value);
    out.at = Trace::active()->variable();
    return out;
  }
  explicit operator int() const { return int(v); }

  friend Traced chain(const Traced &a, T f, T f1, T) {
    Traced out(f);
    if (a.at) out.at = Trace::active()->add(a.at, f1, 0, 0.0);
    return out;
  }
  friend Traced chain(const Traced &a, const Traced &b, T f, T fa, T fb, T, T, T) {
    Traced out(f);
    if (a.at || b.at) out.at = Trace::active()->add(a.at, fa, b.at, fb);
    return out;
  }
};

template <class T, int N> struct RealUnder<Traced<T, N>> : RealUnder<T> {};
template <class T, int N> T value(const Traced<T, N> &x) { return x.v; }
template <class T, int N> Traced<T, N> scaled(const Traced<T, N> &a, T f, T by) { return chain(a, f, by, T(0)); }

THINSHELL_DUAL(Traced)

using Noted = Traced<double, 1>;

}  // namespace thinshell
