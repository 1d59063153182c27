// The machine's limit: a hand-written AVX-512 kernel for the reference work.
//
// Uniform rods, constant friction torque at both joints,
//   tau(u) = (tau_k + (tau_s - tau_k) exp(-(u / v_stribeck)^2)) tanh(u / v_smooth),
// start phi = (0, 0), omega = (0, 0.2), t = 0..100, Tsit5 with rtol = atol = 1e-6.
// Every lane takes its own steps; a lane that ends is refilled from the queue at once.
// Everything but the load q is a compile-time constant, which favours this kernel.
//
// What makes it fast:
//   * phi' = omega, so the stages of phi are sums of accelerations (the Nystrom form of
//     the same tableau, a b with A^2): only two of four slopes are stored and summed;
//   * exp and sincos look up sixteenths in registers (vpermt2pd) and need few terms;
//   * PACKS vectors go through each stage together, to hide the latency of the chain;
//   * the observer bounds a step's cubic first and evaluates it only where it can win.
//
// With -DLIBRARY the functions are the C library's own vector ones, to 4 units in the
// last place, as a kernel would be written that leaves mathematics to its compiler.

#if !defined(__AVX512F__) || !defined(__AVX512DQ__)
#error "lanes.cpp needs a processor with AVX-512 F and DQ"
#endif

#include <immintrin.h>
#include <omp.h>

#include <atomic>

#define PACKS 2  // 1 costs a seventh more, 3 gains nothing
#define EACH for (int v = 0; v < PACKS; ++v)
#define INLINE inline __attribute__((always_inline))

namespace {

using Vec = __m512d;

constexpr double kA = 4.0 / 3.0, kB = 0.5, kD = 1.0 / 3.0;  // uniform rods
constexpr double kTauS = 0.012, kTauK = 0.010, kStribeck = 0.05, kSmooth = 0.01;
constexpr double kStart[4] = {0.0, 0.0, 0.0, 0.2};
constexpr double kEnd = 100.0, kTransient = 80.0, kFirstStep = 0.01;
constexpr double kPi = 3.14159265358979323846;
constexpr double kTolerance = 1e-6;  // atol = rtol

// Tsit5: row i gives stage i + 1; row 6 is the solution, and the seventh stage (FSAL).
constexpr double kTableau[7][6] = {
    {},
    {0.161},
    {-0.008480655492356989, 0.335480655492357},
    {2.8971530571054935, -6.359448489975075, 4.3622954328695815},
    {5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525},
    {5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401,
     -0.028269050394068383},
    {0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742,
     -3.290069515436081, 2.324710524099774}};
constexpr double kError[7] = {
    0.0017800110522257773, 0.0008164344596567463, -0.007880878010261994,
    0.1447110071732629,    -0.5823571654525552,   0.45808210592918686,
    -0.015151515151515152};

// With phi' = omega: phi_i = phi + h (c_i omega + h sum_j (A^2)_ij omega'_j).
struct Nystrom {
  double c[7] = {}, square[7][6] = {}, error[6] = {};
  constexpr Nystrom() {
    for (int i = 0; i < 7; ++i)
      for (int j = 0; j < i; ++j) {
        c[i] += kTableau[i][j];
        for (int l = 0; l < j; ++l) square[i][l] += kTableau[i][j] * kTableau[j][l];
        if (j < 6) error[j] += kError[i] * kTableau[i][j];
      }
  }
};
constexpr Nystrom kNystrom;

INLINE Vec all(double x) { return _mm512_set1_pd(x); }
INLINE Vec larger_size(Vec a, Vec b) { return _mm512_range_pd(a, b, 0b1011); }
INLINE Vec limit_size(Vec a, double b) { return _mm512_range_pd(a, all(b), 0b0010); }
INLINE Vec pick(__mmask8 m, Vec no, Vec yes) { return _mm512_mask_mov_pd(no, m, yes); }

// x * scale rounded to an integer: the integer sits in the low bits of `n`.
struct Rounded {
  Vec n, whole;
};
INLINE Rounded round_scaled(Vec x, double scale) {
  const Vec magic = all(0x1.8p52);
  Vec n = x * all(scale) + magic;
  asm("" : "+v"(n));  // -Ofast would cancel the magic number, here and below
  Vec whole = n - magic;
  asm("" : "+v"(whole));
  return {n, whole};
}

// Tables that stay in registers.
struct Tables {
  Vec exp[2], sin[2], cos[2];
  Tables() {
    for (int i = 0; i < 16; ++i) {
      // The exponent of 2^(n / 16) is added as n << 48: take its fraction off here.
      const double power = __builtin_exp2(i / 16.0);
      long long bits;
      __builtin_memcpy(&bits, &power, 8);
      bits -= static_cast<long long>(i) << 48;
      __builtin_memcpy(reinterpret_cast<char*>(exp) + 8 * i, &bits, 8);
      reinterpret_cast<double*>(sin)[i] = __builtin_sin(i * (kPi / 8));
      reinterpret_cast<double*>(cos)[i] = __builtin_cos(i * (kPi / 8));
    }
  }
};

INLINE Vec look_up(const Vec (&table)[2], Vec n) {
  return _mm512_permutex2var_pd(table[0], _mm512_castpd_si512(n), table[1]);
}

// 2^(x scale / 16); relative error below 1e-14; |x scale| < 16000 is the caller's care.
INLINE Vec exp2_sixteenths(const Tables& tables, Vec x, double scale) {
  const Rounded to = round_scaled(x, scale);
  const Vec r = x * all(scale) - to.whole;
  Vec p = all(1.271604951783647e-09);
  p = p * r + all(1.4676387238432933e-07);
  p = p * r + all(1.3550807778387634e-05);
  p = p * r + all(0.0009383847926296646);
  p = p * r + all(0.04332169878499658);
  p = p * r + all(1.0);
  const __m512i power =
      _mm512_add_epi64(_mm512_castpd_si512(look_up(tables.exp, to.n)),
                       _mm512_slli_epi64(_mm512_castpd_si512(to.n), 48));
  return _mm512_castsi512_pd(power) * p;
}

// sin and cos, absolute error below 1e-13 (4e-14 and 2e-16 from the polynomials).
INLINE void sincos(const Tables& tables, Vec x, Vec& s, Vec& c) {
  const Rounded to = round_scaled(x, 8 / kPi);
  const Vec r = x - to.whole * all(kPi / 8), z = r * r;
  Vec ps = z * all(-0.00019825339804578534) + all(0.008333331030517558);
  ps = ps * z + all(-0.1666666666617345);
  const Vec sr = r + r * z * ps;
  Vec pc = z * all(2.4780347398888363e-05) + all(-0.001388888377161442);
  pc = pc * z + all(0.04166666666272112);
  pc = pc * z + all(-0.4999999999999952);
  const Vec cr = all(1.0) + z * pc;
  const Vec sn = look_up(tables.sin, to.n), cn = look_up(tables.cos, to.n);
  s = sn * cr + cn * sr;
  c = cn * cr - sn * sr;
}

// The friction torque above / below; |u| > 1 is far in the tails: tanh(100), exp(-400).
INLINE void friction(const Tables& tables, Vec rate, Vec& above, Vec& below) {
  constexpr double kLog2e = 1.4426950408889634;
  const Vec u = limit_size(rate, 1.0);
  const Vec e = exp2_sixteenths(tables, u, -32 * kLog2e / kSmooth);
  const Vec g = exp2_sixteenths(tables, u * u, -16 * kLog2e / (kStribeck * kStribeck));
  above = (all(kTauK) + all(kTauS - kTauK) * g) * (all(1.0) - e);
  below = all(1.0) + e;
}

#ifdef LIBRARY
extern "C" Vec _ZGVeN8v_exp(Vec), _ZGVeN8v_tanh(Vec), _ZGVeN8v_sin(Vec),
    _ZGVeN8v_cos(Vec);
#endif

// omega' of the column.
INLINE void accelerate(const Tables& tables, Vec q, Vec p1, Vec p2, Vec w1, Vec w2,
                       Vec& a1, Vec& a2) {
  const Vec D = p1 - p2;
#ifdef LIBRARY
  const Vec s = _ZGVeN8v_sin(D), c = _ZGVeN8v_cos(D);
  const auto torque = [](Vec u) {
    const Vec x = u * all(1 / kStribeck);
    const Vec peak = all(kTauK) + all(kTauS - kTauK) * _ZGVeN8v_exp(-x * x);
    return peak * _ZGVeN8v_tanh(u * all(1 / kSmooth));
  };
  const Vec f1 = torque(w1), f2 = torque(w2 - w1);
#else
  Vec s, c, n1, d1, n2, d2;
  sincos(tables, D, s, c);
  friction(tables, w1, n1, d1);
  friction(tables, w2 - w1, n2, d2);
  const Vec f1 = n1 / d1, f2 = n2 / d2;
#endif
  const Vec r2 = (D - f2) + all(kB) * s * w1 * w1;
  const Vec r1 = (q - all(kB) * w2 * w2) * s - p1 - D - (f1 - f2);
  const Vec m = all(kB) * c;
  const Vec inverse = all(1.0) / (all(kA * kD) - m * m);
  a1 = (all(kD) * r1 - m * r2) * inverse;
  a2 = (all(kA) * r2 - m * r1) * inverse;
}

// The size of the cubic Hermite interpolant's extrema inside the step, else 0.
__attribute__((noinline)) Vec extremum(Vec x0, Vec x1, Vec m0, Vec m1) {
  const Vec rise = x1 - x0;
  const Vec c2 = all(3.0) * rise - all(2.0) * m0 - m1, c3 = m0 + m1 - all(2.0) * rise;
  // 3 c3 s^2 + 2 c2 s + m0 = 0, both roots by the stable form
  const Vec square = c2 * c2 - all(3.0) * c3 * m0;
  const __mmask8 real = _mm512_cmp_pd_mask(square, all(0.0), _CMP_GE_OQ);
  const Vec root = _mm512_sqrt_pd(_mm512_max_pd(square, all(0.0)));
  const __mmask8 negative = _mm512_movepi64_mask(_mm512_castpd_si512(c2));
  const Vec w = -(c2 + pick(negative, root, -root));
  const Vec tiny = all(1e-300);
  const __mmask8 flat = _mm512_cmp_pd_mask(c3, all(0.0), _CMP_EQ_OQ);
  const __mmask8 none = _mm512_cmp_pd_mask(w, all(0.0), _CMP_EQ_OQ);
  const Vec parts[2] = {w / pick(flat, all(3.0) * c3, tiny), m0 / pick(none, w, tiny)};
  Vec best = all(0.0);
  for (const Vec& part : parts) {
    const __mmask8 inside = real & _mm512_cmp_pd_mask(part, all(0.0), _CMP_GT_OQ) &
                            _mm512_cmp_pd_mask(part, all(1.0), _CMP_LT_OQ);
    const Vec value = x0 + part * (m0 + part * (c2 + part * c3));
    best = pick(inside, best, larger_size(best, value));
  }
  return best;
}

struct Queue {
  const double* q;
  long n;
  double *amplitude, *state, *steps;
  std::atomic<long> next{0};
};

template <bool observe>
void work(Queue& queue) {
  const Tables tables;
  Vec q[PACKS], y[4][PACKS], k[7][2][PACKS], h[PACKS], rest[PACKS], steps[PACKS];
  Vec amplitude[3][PACKS];
  __mmask8 observed[PACKS];
  long index[PACKS][8];
  long alive = 0;

  // Puts the queue's next lane into the place of lane `bit`, or parks that place.
  const auto refill = [&](int v, int lane) {
    const __mmask8 bit = 1 << lane;
    const long i = queue.next.fetch_add(1, std::memory_order_relaxed);
    const bool real = i < queue.n;
    index[v][lane] = real ? i : -1;
    alive += real;
    q[v] = pick(bit, q[v], all(real ? queue.q[i] : 0.0));
    for (int c = 0; c < 4; ++c) y[c][v] = pick(bit, y[c][v], all(real * kStart[c]));
    h[v] = pick(bit, h[v], all(kFirstStep));
    // a parked lane rests at zero and never arrives
    rest[v] = pick(bit, rest[v], all(!real ? 1e300 : observe ? kTransient : kEnd));
    steps[v] = pick(bit, steps[v], all(0.0));
    observed[v] &= ~bit;
    Vec a1, a2;
    accelerate(tables, q[v], y[0][v], y[1][v], y[2][v], y[3][v], a1, a2);
    k[0][0][v] = pick(bit, k[0][0][v], a1);
    k[0][1][v] = pick(bit, k[0][1][v], a2);
  };

  // A lane has landed: its observed window begins, or it ends.
  const auto arrive = [&](int v, int lane) {
    const __mmask8 bit = 1 << lane;
    if (observe && !(observed[v] & bit)) {
      observed[v] |= bit;
      rest[v] = pick(bit, rest[v], all(kEnd - kTransient));
      const Vec x[3] = {y[0][v], y[1][v], y[1][v] - y[0][v]};
      for (int c = 0; c < 3; ++c)
        amplitude[c][v] = pick(bit, amplitude[c][v], _mm512_abs_pd(x[c]));
      return;
    }
    const long i = index[v][lane];
    for (int c = 0; c < 4; ++c) queue.state[4 * i + c] = y[c][v][lane];
    for (int c = 0; c < 3; ++c)
      queue.amplitude[3 * i + c] = observe ? amplitude[c][v][lane] : 0.0;
    queue.steps[i] = steps[v][lane];
    --alive;
    refill(v, lane);
  };

  EACH {
    q[v] = h[v] = rest[v] = steps[v] = all(0.0);
    for (int c = 0; c < 4; ++c) y[c][v] = all(0.0);
    for (int c = 0; c < 3; ++c) amplitude[c][v] = all(0.0);
    k[0][0][v] = k[0][1][v] = all(0.0);
    observed[v] = 0;
    for (int lane = 0; lane < 8; ++lane) refill(v, lane);
  }

  while (alive > 0) {
    Vec step[PACKS], z[4][PACKS];
    EACH step[v] = _mm512_min_pd(h[v], rest[v]);

#pragma GCC unroll 6
    for (int i = 1; i < 7; ++i) {
      EACH {
        Vec s[2], t[2];
        for (int c = 0; c < 2; ++c) {
          s[c] = all(kTableau[i][0]) * k[0][c][v];
#pragma GCC unroll 6
          for (int j = 1; j < i; ++j) s[c] += all(kTableau[i][j]) * k[j][c][v];
          t[c] = all(kNystrom.c[i]) * y[2 + c][v];
          if (i > 1) {
            Vec u = all(kNystrom.square[i][0]) * k[0][c][v];
#pragma GCC unroll 6
            for (int j = 1; j < i - 1; ++j)
              u += all(kNystrom.square[i][j]) * k[j][c][v];
            t[c] += step[v] * u;
          }
          z[c][v] = y[c][v] + step[v] * t[c];
          z[2 + c][v] = y[2 + c][v] + step[v] * s[c];
        }
        accelerate(tables, q[v], z[0][v], z[1][v], z[2][v], z[3][v], k[i][0][v],
                   k[i][1][v]);
      }
    }

    EACH {
      // the RMS norm of error / (atol + rtol max(|y0|, |y1|)), squared
      Vec square = all(0.0);
      for (int c = 0; c < 2; ++c) {
        Vec ew = all(kError[0] / kTolerance) * k[0][c][v];
#pragma GCC unroll 6
        for (int j = 1; j < 7; ++j) ew += all(kError[j] / kTolerance) * k[j][c][v];
        Vec ep = all(kNystrom.error[0] / kTolerance) * k[0][c][v];
#pragma GCC unroll 5
        for (int j = 1; j < 6; ++j)
          ep += all(kNystrom.error[j] / kTolerance) * k[j][c][v];
        const Vec sp = all(1.0) + larger_size(y[c][v], z[c][v]);
        const Vec sw = all(1.0) + larger_size(y[2 + c][v], z[2 + c][v]);
        const Vec rp = step[v] * ep / sp, rw = ew / sw;
        square += rp * rp + rw * rw;
      }
      square *= step[v] * step[v] * all(0.25);
      const __mmask8 keep = _mm512_cmp_pd_mask(square, all(1.0), _CMP_LE_OQ);
      const __mmask8 last = _mm512_cmp_pd_mask(h[v], rest[v], _CMP_GE_OQ);

      // 0.9 square^(-1/10) within 0.2 .. 10; the logarithm to 2e-5, enough for a step
      square = _mm512_max_pd(square, all(1e-30));
      const Vec m = _mm512_getmant_pd(square, _MM_MANT_NORM_1_2, _MM_MANT_SIGN_zero);
      Vec log = m * all(0.04300495779188456) + all(-0.4025133935491493);
      log = log * m + all(1.5894742949757037);
      log = log * m + all(-3.48987855068487);
      log = log * m + all(5.047855413441358);
      log = log * m + all(-2.787926207304043);
      log += _mm512_getexp_pd(square);
      Vec factor = all(0.9) * exp2_sixteenths(tables, log, -1.6);
      factor = _mm512_max_pd(_mm512_min_pd(factor, all(10.0)), all(0.2));
      // a step shortened to land does not shorten the next one
      h[v] = pick(keep & last, step[v] * factor, h[v]);

      if (observe && observed[v]) {
        const __mmask8 seen = keep & observed[v];
        const Vec x0[3] = {y[0][v], y[1][v], y[1][v] - y[0][v]};
        const Vec x1[3] = {z[0][v], z[1][v], z[1][v] - z[0][v]};
        const Vec v0[3] = {y[2][v], y[3][v], y[3][v] - y[2][v]};
        const Vec v1[3] = {z[2][v], z[3][v], z[3][v] - z[2][v]};
        for (int c = 0; c < 3; ++c) {
          // |cubic| <= max(|x0|, |x1|) + 4/27 h (|v0| + |v1|)
          const Vec speed = _mm512_abs_pd(v0[c]) + _mm512_abs_pd(v1[c]);
          const Vec bound = larger_size(x0[c], x1[c]) + all(4.0 / 27) * step[v] * speed;
          const __mmask8 wins =
              _mm512_mask_cmp_pd_mask(seen, bound, amplitude[c][v], _CMP_GT_OQ);
          if (__builtin_expect(wins != 0, 0)) {
            const Vec inner = extremum(x0[c], x1[c], step[v] * v0[c], step[v] * v1[c]);
            amplitude[c][v] =
                pick(wins, amplitude[c][v],
                     larger_size(amplitude[c][v], larger_size(inner, x1[c])));
          }
        }
      }

      steps[v] += all(1.0);
      for (int c = 0; c < 4; ++c) y[c][v] = pick(keep, y[c][v], z[c][v]);
      for (int c = 0; c < 2; ++c) k[0][c][v] = pick(keep, k[0][c][v], k[6][c][v]);
      rest[v] = _mm512_mask_sub_pd(rest[v], keep, rest[v], step[v]);
      for (unsigned landed = keep & last; landed; landed &= landed - 1)
        arrive(v, __builtin_ctz(landed));
    }
  }
}

}  // namespace

// Every lane from 0 to 100. amplitude (n, 3): the largest |phi1|, |phi2|, |phi2 - phi1|
// over t = 80..100 where `observe`, else 0; state (n, 4) at 100; steps (n) attempted.
extern "C" void ziegler_lanes(long n, const double* q, int threads, int observe,
                              double* amplitude, double* state, double* steps) {
  Queue queue{q, n, amplitude, state, steps};
#pragma omp parallel num_threads(threads)
  {
    if (observe)
      work<true>(queue);
    else
      work<false>(queue);
  }
}
