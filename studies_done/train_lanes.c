/* Released train of 106 equal draft gears: one train over its vehicles, beside TRAINS trains in the lanes of a vector.
 *
 *     cc -O3 -march=native -fno-math-errno -fno-trapping-math -ffp-contract=off -DTRAINS=8 studies_done/train_lanes.c -lm \
 *        -o /tmp/train_lanes && /tmp/train_lanes
 *
 * Both have the operations of `_clip_force`, `_runs_on`, `_run_on` and `_position` of plant_sim/kernel.py and give the
 * same bits. The second form has branches as masks, no tail of vehicles and one loop in place of three. Prints ns of
 * processor time per vehicle and step, the least of 15 repetitions by turns.
 */
#define _GNU_SOURCE
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#ifndef TRAINS
#define TRAINS 8
#endif
enum { VEHICLES = 106, STEPS = 2000, REPEATS = 15 };
typedef double lanes __attribute__((vector_size(8 * TRAINS)));
typedef long long mask __attribute__((vector_size(8 * TRAINS)));
typedef struct { lanes x, v, force, h, dh, draft, buff, work[4]; } State;
typedef struct { lanes gap, inverse_mass, c0, c1, c2, grade, grade_x, curve; } Vehicle;
typedef struct { double slack, stiffness, damping, f0, x0, a1, a2, ratio, stroke, stop, transition; } Gear;
static const Gear GEAR = {0.005, 8e7, 1e4, 2e5, 0.01, 1e7, 1e8, 0.3, 0.08, 1e9, 1e5};
static const double CONSTANTS[8] = {13.0, 1e-5, 1e3, 10.0, 0.5, 100.0, 1e-3, 50.0}; /* order of Vehicle */
static const double DT = 0.005;

static lanes choose(mask m, lanes a, lanes b) { return (lanes)((m & (mask)a) | (~m & (mask)b)); }
static lanes most(lanes a, lanes b) { return choose(a > b, a, b); }
static lanes least(lanes a, lanes b) { return choose(a < b, a, b); }
static mask sign(void) { return (mask){} + (long long)0x8000000000000000ULL; }
static lanes side_of(lanes x) { return (lanes)(((mask)x & sign()) | (mask)((lanes){} + 1.0)); }
static lanes size_of(lanes x) { return (lanes)((mask)x & ~sign()); }

__attribute__((noinline)) static long many_trains(State *state, const Vehicle *vehicle, Gear g)
{
    const lanes zero = {};
    long ran_on = 0;
    for (int step = 0; step < STEPS; step++) {
        lanes front = zero, x = state[0].x, v = state[0].v;
        mask forward = ~(mask){};
        for (int i = 0; i < VEHICLES; i++) {
            State *s = state + i;
            const Vehicle *c = vehicle + i;
            lanes next_x = s[1].x, next_v = s[1].v, rate = v - next_v, deflection = x - next_x - c->gap;
            lanes side = side_of(deflection), beyond = most(side * deflection - g.slack, zero);
            lanes d = least(beyond, zero + g.stroke), q = d / (d + g.x0);
            lanes loading = g.f0 * q + d * (g.a1 + g.a2 * d), unloading = g.ratio * loading;
            lanes h = most(side * s->h, zero) + g.stiffness * (d - most(side * s->dh, zero));
            h = least(most(h, unloading), loading);
            s->h = side * h, s->dh = side * d;
            h = least(most(h + side * g.transition * rate, unloading), loading);
            lanes force = side * (h + g.stop * (beyond - d)) + g.damping * q * rate;
            if (i == VEHICLES - 1) force = zero;
            s->draft = most(s->draft + 0.0, force), s->buff = least(s->buff + 0.0, force), s->force = force;
            lanes viscous = -v * (c->c1 + c->c2 * size_of(v)), grade = c->grade + c->grade_x * x;
            lanes couplers = front - force, quick = DT * c->inverse_mass;
            lanes free = v + quick * (couplers + grade + viscous), after = free - quick * (c->c0 + c->curve);
            lanes moved = 0.5 * DT * (v + after);
            s->work[0] += viscous * moved - c->c0 * moved, s->work[1] += grade * moved;
            s->work[2] -= c->curve * moved, s->work[3] += couplers * moved;
            forward &= (free > zero) & (after > zero);
            s->v = after, s->x = x + DT * after;
            front = force, x = next_x, v = next_v;
        }
        for (int lane = 0; lane < TRAINS; lane++) ran_on += forward[lane] != 0;
    }
    return ran_on;
}

#define MOST(a, b) ((a) > (b) ? (a) : (b))
#define LEAST(a, b) ((a) < (b) ? (a) : (b))
#define ROW double *restrict
__attribute__((noinline)) static long one_train(
    ROW x, ROW v, ROW force, ROW h_kept, ROW d_kept, ROW draft, ROW buff, ROW w0, ROW w1, ROW w2, ROW w3, ROW after,
    ROW viscous, ROW grade, ROW gap, ROW inverse_mass, ROW c0, ROW c1, ROW c2, ROW grade_0, ROW grade_x, ROW curve,
    Gear g)
{
    long ran_on = 0;
    for (int step = 0; step < STEPS; step++) {
        for (int i = 0; i < VEHICLES - 1; i++) {
            double deflection = x[i] - x[i + 1] - gap[i], side = copysign(1.0, deflection), rate = v[i] - v[i + 1];
            double beyond = MOST(side * deflection - g.slack, 0.0), d = LEAST(beyond, g.stroke), q = d / (d + g.x0);
            double loading = g.f0 * q + d * (g.a1 + g.a2 * d), unloading = g.ratio * loading;
            double h = MOST(side * h_kept[i], 0.0), before = MOST(side * d_kept[i], 0.0);
            h += g.stiffness * (d - before), h = MOST(h, unloading), h = LEAST(h, loading);
            h_kept[i] = side * h, d_kept[i] = side * d;
            h = h + side * g.transition * rate, h = MOST(h, unloading), h = LEAST(h, loading);
            double f = side * (h + g.stop * (beyond - d)) + g.damping * q * rate, high = draft[i] + 0.0;
            double low = buff[i] + 0.0;
            force[i + 1] = f, draft[i] = MOST(high, f), buff[i] = LEAST(low, f);
        }
        long forward = 0;
        for (int i = 0; i < VEHICLES; i++) {
            double running = -v[i] * (c1[i] + c2[i] * fabs(v[i])), slope = grade_0[i] + grade_x[i] * x[i];
            double quick = DT * inverse_mass[i], free = v[i] + quick * (force[i] - force[i + 1] + slope + running);
            double later = free - quick * (c0[i] + curve[i]);
            after[i] = later, viscous[i] = running, grade[i] = slope, forward += (free > 0.0) & (later > 0.0);
        }
        ran_on += forward == VEHICLES;
        for (int i = 0; i < VEHICLES; i++) {
            double moved = 0.5 * DT * (v[i] + after[i]);
            w0[i] += viscous[i] * moved - c0[i] * moved, w1[i] += grade[i] * moved, w2[i] -= curve[i] * moved;
            w3[i] += (force[i] - force[i + 1]) * moved, v[i] = after[i], x[i] += DT * after[i];
        }
    }
    return ran_on;
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}

int main(void)
{
    State *state = aligned_alloc(64, sizeof(State) * (VEHICLES + 1));
    Vehicle *vehicle = aligned_alloc(64, sizeof(Vehicle) * (VEHICLES + 1));
    double *r[22], one = 1e9, many = 1e9;
    long same = 1;
    for (int row = 0; row < 22; row++) r[row] = aligned_alloc(64, 8 * 128);
    for (int repeat = 0; repeat < REPEATS; repeat++) {
        memset(state, 0, sizeof(State) * (VEHICLES + 1));
        for (int row = 0; row < 22; row++) memset(r[row], 0, 8 * 128);
        for (int i = 0; i <= VEHICLES; i++) {
            r[0][i] = 1400.0 - 13.0 * i + 0.01 * sin(7.0 * i), r[1][i] = 20.0;
            for (int k = 0; k < 8; k++) r[14 + k][i] = CONSTANTS[k];
            state[i].x = (lanes){} + r[0][i], state[i].v = (lanes){} + 20.0;
            for (int k = 0; k < 8; k++) ((lanes *)(vehicle + i))[k] = (lanes){} + CONSTANTS[k];
        }
        double begin = seconds();
        long count = one_train(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11], r[12], r[13],
                               r[14], r[15], r[16], r[17], r[18], r[19], r[20], r[21], GEAR);
        one = fmin(one, seconds() - begin), begin = seconds();
        same &= many_trains(state, vehicle, GEAR) == TRAINS * count;
        many = fmin(many, (seconds() - begin) / TRAINS);
        for (int i = 0; i < VEHICLES; i++)
            for (int lane = 0; lane < TRAINS; lane++) same &= state[i].x[lane] == r[0][i] && state[i].v[lane] == r[1][i];
    }
    double steps = 1e-9 * STEPS * VEHICLES;
    printf("one train over its vehicles %.2f ns, %d trains in lanes %.2f ns per vehicle and step: %.2f times as fast; "
           "%s bits\n", one / steps, TRAINS, many / steps, one / many, same ? "same" : "other");
    return same ? 0 : 1;
}
