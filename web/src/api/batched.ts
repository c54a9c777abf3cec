// One request for what several components ask for at the same time.

const GATHER_MS = 20;

interface Batch<Value> {
  readonly keys: Set<string>;
  readonly answer: Promise<ReadonlyMap<string, Value>>;
}

/** Returns a function that loads the value of a key, together with those of at most `most` keys that are asked for within moments. */
export function batched<Value>(load: (keys: readonly string[]) => Promise<ReadonlyMap<string, Value>>, most: number): (key: string) => Promise<Value | undefined> {
  let batch: Batch<Value> | null = null;

  function begin(): Batch<Value> {
    const keys = new Set<string>();
    const gathered = new Promise<void>((resolve) => setTimeout(resolve, GATHER_MS));
    const answer = gathered.then(() => {
      if (batch?.keys === keys) batch = null;
      return load([...keys]);
    });
    return { keys, answer };
  }

  return async (key) => {
    if (batch === null || (batch.keys.size >= most && !batch.keys.has(key))) batch = begin();
    const { keys, answer } = batch;
    keys.add(key);
    return (await answer).get(key);
  };
}
