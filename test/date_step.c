/* Step of the date of a process by STEP_BY s at the date STEP_AT, without rights to set the clock of the machine.
   Reads of the date and ends of waits on it change as with a real step; the steady clock does not. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define FIRST_DATE 1e9 /* smaller times are of the steady clock, for conditions with that clock */

static double seconds(const struct timespec *t) { return t->tv_sec + 1e-9 * t->tv_nsec; }

static double setting(const char *name) { return atof(getenv(name)); }

static void shift(struct timespec *t, double by)
{
    long long n = t->tv_sec * 1000000000LL + t->tv_nsec + (long long)(by * 1e9);
    t->tv_sec = n / 1000000000LL;
    t->tv_nsec = n % 1000000000LL;
}

int clock_gettime(clockid_t clock, struct timespec *t)
{
    int status = syscall(SYS_clock_gettime, clock, t);
    if (clock == CLOCK_REALTIME && seconds(t) >= setting("STEP_AT"))
        shift(t, setting("STEP_BY"));
    return status;
}

int gettimeofday(struct timeval *restrict date, void *restrict zone)
{
    struct timespec t;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &t);
    date->tv_sec = t.tv_sec;
    date->tv_usec = t.tv_nsec / 1000;
    return 0;
}

int pthread_cond_timedwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
                           const struct timespec *restrict end)
{
    static int (*original)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    struct timespec now, moved = *end;
    if (original == NULL)
        original = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    syscall(SYS_clock_gettime, CLOCK_REALTIME, &now);
    if (seconds(end) > FIRST_DATE && (seconds(&now) >= setting("STEP_AT") || seconds(end) > setting("STEP_AT")))
        shift(&moved, -setting("STEP_BY"));
    return original(condition, mutex, &moved);
}
