// The column of two uniform rods with smoothed friction, or with dry friction where
// v_smooth is 0, followed for long: for each lane the largest |phi1|, |phi2|,
// |phi2 - phi1| over the last part of a span. It shares nothing with the package:
// Dormand and Prince's pair of order 5 (J. R. Dormand, P. J. Prince, J. Comput. Appl.
// Math. 6 (1980) 19-26) in scalars, with the C library's functions. With dry friction
// steps are short, and ends of stick and slip are bisected by shorter steps.
#include <cmath>
#include <algorithm>

namespace {

struct Column { double q, tau_s, tau_k, v_stribeck, v_smooth; };

double friction(const Column& c, double u) {
    const double r = u / c.v_stribeck;
    return (c.tau_k + (c.tau_s - c.tau_k) * std::exp(-r * r)) * std::tanh(u / c.v_smooth);
}

// The mass matrix [[a, h], [h, d]], and the forces without friction.
struct Forces { double h, r1, r2; };
const double a = 4.0 / 3, b = 0.5, d = 1.0 / 3;

Forces forces(const Column& p, const double* y) {
    const double s = std::sin(y[0] - y[1]), c = std::cos(y[0] - y[1]);
    return {b * c, p.q * s - 2 * y[0] + y[1] - b * s * y[3] * y[3],
            y[0] - y[1] + b * s * y[2] * y[2]};
}

// Accelerations w and the joints' torques t of dry friction in modes m: -1, 1, 0 (stick).
void dry(const Column& p, const Forces& g, const int* m, double* w, double* t) {
    t[0] = m[0] * p.tau_k, t[1] = m[1] * p.tau_k;
    if (m[0] && m[1]) {
        const double r1 = g.r1 - t[0] + t[1], r2 = g.r2 - t[1], det = a * d - g.h * g.h;
        w[0] = (d * r1 - g.h * r2) / det, w[1] = (a * r2 - g.h * r1) / det;
    } else if (m[0]) {
        w[0] = w[1] = (g.r1 + g.r2 - t[0]) / (a + 2 * g.h + d);
        t[1] = g.r2 - (g.h + d) * w[0];
    } else {
        w[0] = 0, w[1] = m[1] ? (g.r2 - t[1]) / d : 0;
        if (!m[1]) t[1] = g.r2;
        t[0] = g.r1 + t[1] - g.h * w[1];
    }
}

void field(const Column& p, const int* m, const double* y, double* f) {
    const Forces g = forces(p, y);
    f[0] = y[2], f[1] = y[3];
    if (p.v_smooth == 0) {
        double t[2];
        dry(p, g, m, f + 2, t);
        return;
    }
    const double t1 = friction(p, y[2]), t2 = friction(p, y[3] - y[2]);
    const double r1 = g.r1 - t1 + t2, r2 = g.r2 - t2, det = a * d - g.h * g.h;
    f[2] = (d * r1 - g.h * r2) / det, f[3] = (a * r2 - g.h * r1) / det;
}

// How far a joint is from the end of its mode.
double guard(const Column& p, const int* m, const double* y, int i) {
    if (m[i]) return m[i] * (i ? y[3] - y[2] : y[2]);
    double w[2], t[2];
    dry(p, forces(p, y), m, w, t);
    return p.tau_s - std::fabs(t[i]);
}

// Modes that agree with the law: tau_s has to be overcome, else tau_k; of those the ones
// in which fewest joints slip, then the most overloaded. `rest`: which joints have no
// rate; `freed`: the one that has reached its most, -1 if none has.
void choose(const Column& p, const double* y, const bool* rest, int freed, int* m) {
    const int order[3] = {0, 1, -1};
    int found[2] = {m[0], m[1]};
    double best = -1e300, w[2], t[2];
    const Forces g = forces(p, y);
    for (int i : order) for (int j : order) {
        const int n[2] = {rest[0] ? i : m[0], rest[1] ? j : m[1]};
        if ((freed == 0 && !n[0]) || (freed == 1 && !n[1])) continue;
        bool agrees = true, overcome = true;
        double over = 0;
        for (int k = 0; k < 2; k++) {
            if (!rest[k]) continue;
            int held[2] = {n[0], n[1]};
            held[k] = 0;
            dry(p, g, held, w, t);
            if (!n[k]) {
                agrees &= std::fabs(t[k]) <= p.tau_s;
                continue;
            }
            const double pull = n[k] * t[k];
            agrees &= pull > (k == freed ? 0 : p.tau_k);
            overcome &= k == freed || pull > p.tau_s;
            over = std::max(over, pull - p.tau_s);
        }
        // torques are below 100
        const double rank = 4e3 * overcome + 1e3 * (!n[0] + !n[1]) + over;
        if (agrees && rank > best) best = rank, found[0] = n[0], found[1] = n[1];
    }
    m[0] = found[0], m[1] = found[1];
}

const double A[7][6] = {
    {0},
    {1.0 / 5},
    {3.0 / 40, 9.0 / 40},
    {44.0 / 45, -56.0 / 15, 32.0 / 9},
    {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
    {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
    {35.0 / 384, 0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84}};
const double E[7] = {71.0 / 57600, 0, -71.0 / 16695, 71.0 / 1920, -17253.0 / 339200,
                     22.0 / 525, -1.0 / 40};

// The largest size of a cubic over a step, by its ends and where its slope changes sign.
double peak(double g0, double v0, double g1, double v1) {
    double top = std::max(std::fabs(g0), std::fabs(g1));
    if (v0 * v1 < 0) {
        const double c2 = 3 * (g1 - g0) - 2 * v0 - v1, c3 = v0 + v1 - 2 * (g1 - g0);
        double x = v0 / (v0 - v1);
        for (int i = 0; i < 4; i++)
            x -= (v0 + x * (2 * c2 + 3 * x * c3)) / (2 * c2 + 6 * x * c3);
        if (x > 0 && x < 1)
            top = std::max(top, std::fabs(g0 + x * (v0 + x * (c2 + c3 * x))));
    }
    return top;
}

// The stages of a step from y, of which the first is known; z: where it ends.
void stages(const Column& p, const int* m, const double* y, double h, double k[7][4],
            double* z) {
    for (int i = 1; i < 7; i++) {
        for (int j = 0; j < 4; j++) {
            double sum = 0;
            for (int l = 0; l < i; l++) sum += A[i][l] * k[l][j];
            z[j] = y[j] + h * sum;
        }
        field(p, m, z, k[i]);
    }
}

const double LONGEST = 0.02;  // of a step with dry friction: a guard falls once in it

// The step cut where the first mode ends, and the modes behind it.
void land(const Column& p, int* m, double* y, double* h, double k[7][4], double* z) {
    double low = 0, high = *h;
    while (high - low > 1e-13) {
        const double mid = (low + high) / 2;
        stages(p, m, y, mid, k, z);
        (guard(p, m, z, 0) < 0 || guard(p, m, z, 1) < 0 ? high : low) = mid;
    }
    stages(p, m, y, *h = high, k, z);
    const int i = guard(p, m, z, 0) < 0 ? 0 : 1;
    const int freed = m[i] ? -1 : i;
    const bool rest[2] = {!m[0] || i == 0, !m[1] || i == 1};
    if (rest[0]) z[2] = 0;
    if (rest[1]) z[3] = z[2];
    choose(p, z, rest, freed, m);
}

void lane(const Column& p, double* y, double span, double last, double tol, double* out) {
    const bool dry = p.v_smooth == 0;
    double t = 0, h = 1e-3, k[7][4];
    out[0] = out[1] = out[2] = 0;
    int m[2] = {1, 1};
    if (dry) {
        const bool rest[2] = {y[2] == 0, y[3] == y[2]};
        m[0] = y[2] < 0 ? -1 : 1, m[1] = y[3] < y[2] ? -1 : 1;
        choose(p, y, rest, -1, m);
    }
    field(p, m, y, k[0]);
    while (t < span) {
        h = std::min(h, span - t);
        if (dry) h = std::min(h, LONGEST);
        double z[4], error = 0;
        stages(p, m, y, h, k, z);
        for (int j = 0; j < 4; j++) {
            double e = 0;
            for (int i = 0; i < 7; i++) e += E[i] * k[i][j];
            e *= h / (tol + tol * std::max(std::fabs(y[j]), std::fabs(z[j])));
            error += e * e / 4;
        }
        if (error <= 1) {
            const bool ends = dry && (guard(p, m, z, 0) < 0 || guard(p, m, z, 1) < 0);
            if (ends) land(p, m, y, &h, k, z);
            if (t + h > span - last) {
                out[0] = std::max(out[0], peak(y[0], h * k[0][0], z[0], h * k[6][0]));
                out[1] = std::max(out[1], peak(y[1], h * k[0][1], z[1], h * k[6][1]));
                out[2] = std::max(out[2], peak(y[1] - y[0], h * (k[0][1] - k[0][0]),
                                               z[1] - z[0], h * (k[6][1] - k[6][0])));
            }
            t += h;
            for (int j = 0; j < 4; j++) y[j] = z[j], k[0][j] = k[6][j];
            if (ends) field(p, m, y, k[0]);
            if (ends) h = LONGEST;
        }
        h *= std::min(5.0, std::max(0.2, 0.85 * std::pow(error + 1e-12, -0.1)));
        if (!(h > 1e-12)) break;
    }
}

}  // namespace

// columns (n, 5), states (n, 4; changed to those at the end), spans, lasts (n)
extern "C" void follow(long n, const double* columns, double* states, const double* spans,
                       const double* lasts, double tol, double* amplitudes) {
#pragma omp parallel for schedule(dynamic, 4)
    for (long i = 0; i < n; i++) {
        Column p{columns[5 * i], columns[5 * i + 1], columns[5 * i + 2],
                 columns[5 * i + 3], columns[5 * i + 4]};
        lane(p, states + 4 * i, spans[i], lasts[i], tol, amplitudes + 3 * i);
    }
}
