"""Clients that repeat one request for some seconds: the number of responses they get.

`python -m benchmarks.scale.several URL TOKEN CLIENTS SECONDS`; prints the answers a second. A process of its own, so
that they take no time of whoever measures.
"""

import sys
import threading
import time

import urllib3


def main() -> None:
    """Run the clients, and print the number of answers."""
    url, token, clients, seconds = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
    counts = [0] * clients
    until = time.perf_counter() + seconds

    def ask(number: int) -> None:
        with urllib3.PoolManager(retries=False, timeout=120) as pool:
            while time.perf_counter() < until:
                answer = pool.request("GET", url, headers={"Authorization": f"Bearer {token}"})
                if answer.status >= 300:
                    raise SystemExit(f"{url}: {answer.status}")
                counts[number] += 1

    began = time.perf_counter()
    threads = [threading.Thread(target=ask, args=(number,)) for number in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(sum(counts) / (time.perf_counter() - began))


if __name__ == "__main__":
    main()
