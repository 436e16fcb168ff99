/* Links the engine into a C program and checks that both models, by themselves and in a stream, pull a parked vehicle onto
   its true place. The linker fails where any call can panic. */
#include <stdint.h>
#include <stdio.h>

double gnssins_parked_ned(uint32_t seconds);
double gnssins_parked_ecef(uint32_t seconds);
double gnssins_streamed_ned(uint32_t seconds);
double gnssins_streamed_ecef(uint32_t seconds);

static int check(const char *what, double error_m)
{
    int ok = error_m >= 0.0 && error_m < 0.05;
    printf("no_std engine without a panic, 60 s parked, %s: position error %.1e m: %s\n", what, error_m,
           ok ? "ok" : "FAILED");
    return ok;
}

int main(void)
{
    int ok = check("filter, NED", gnssins_parked_ned(60));
    ok &= check("filter, ECEF", gnssins_parked_ecef(60));
    ok &= check("stream, NED", gnssins_streamed_ned(60));
    ok &= check("stream, ECEF", gnssins_streamed_ecef(60));
    return !ok;
}
